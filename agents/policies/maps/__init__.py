"""How loud a probe is where: insertions enter, a fitted map leaves, and the best schedules that are found on it.

Imports fixed policies, places and domains of ``policies``, rollouts and records; torch in ``fit`` alone.
"""
