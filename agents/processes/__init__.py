"""Worker processes and signals: portions of work enter, outcomes leave one by one; an end is told truly.

Imports the records' notion of work that is under way, and the machine's cores.
"""
