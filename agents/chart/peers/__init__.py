"""The same cantilever in other programs: meshes and steps enter, errors against cost leave, a row a program.

Imports the chart's tables and records, chains and their runs; the programs themselves when they run.
"""
