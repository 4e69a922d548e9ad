"""Judging probes: designs enter, trials, fronts and sensitivities leave.

Imports policies and what is below them.
"""
