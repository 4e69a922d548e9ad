"""Judging policies: tables of episodes enter, reports, fronts, checks and films leave.

Imports policies and what is below them.
"""
