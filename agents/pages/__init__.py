"""README and docs: stored results enter, blocks of text and pictures leave.

Imports any room that has results.
"""
