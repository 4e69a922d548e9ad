"""A run as an inspection engineer sees it: a policy in a tube enters, channels, strip chart, Lissajous figures leave.

``false_calls`` counts what noise alone calls, ``anchors`` asks what a ranking hangs on.

The model is ``probe_env.inspection``. Imports policies, rollouts and records.
"""
