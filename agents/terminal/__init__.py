"""The user's terminal: arguments, names and passwords enter, lines and tables leave.

Imports nothing of the other rooms.
"""
