"""A run as an inspection engineer sees it: a policy in a tube enters, channels, strip chart, Lissajous figures leave.

The model is ``probe_env.inspection``. Imports policies, rollouts and records.
"""
