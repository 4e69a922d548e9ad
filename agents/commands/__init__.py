"""The commands' arguments, a dataclass each; what they run is imported when they do.

Imports any room.
"""
