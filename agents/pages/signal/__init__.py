"""The page of the signal: stored results enter, blocks of text leave.

Which policy finds what, and whether finer fidelities hear the same: of whole tubes, and along them. Imports any room
that has results, and the pages' sources.
"""
