"""The commands, a dataclass each: arguments enter; what they call writes files and prints tables, which leave.

Imports any room, when a command runs; at the start only what names and checks the arguments.
"""
