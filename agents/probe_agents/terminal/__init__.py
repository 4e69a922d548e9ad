"""Terminal: fidelity arguments, names, tables, errors and progress messages.

Imports no other part of ``agents``.
"""
