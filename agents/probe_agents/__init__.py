"""Decide and judge: scenes, logs and settings enter; policies, trained agents, designs, tables and pages leave.

Rooms stand in layers, which the import linter holds (``pyproject.toml``); ``cli`` is where commands begin. Imports
``probe_env``, never the other way round.
"""
