"""Policies: fixed laws, schedules, the vibration map, planners and trained networks, see ``catalogue``."""
