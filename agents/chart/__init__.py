"""Accuracy against cost: scenes, insertions and steps enter, errors and what they cost leave.

Runs, then errors, then tables and pictures; where methods stop is in ``stability``, other programs in ``peers``.
Imports the study's cases and records.
"""
