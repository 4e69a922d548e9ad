"""Judging probes: designs enter, trials, fronts and sensitivities leave, in table 2's tubes or a plant's.

Imports policies and what is below them.
"""
