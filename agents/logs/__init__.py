"""Logs of inspection rigs: a text file or a sheet of anyone's enters, a clean log in SI units leaves.

What is mended is counted, what cannot be is refused by file, line, column and value; nothing in a file is executed.
Imports records, terminal, and of the package below schedules and the task's ranges.
"""
