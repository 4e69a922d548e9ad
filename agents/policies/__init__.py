"""Policies: observations enter, actions leave; fixed laws, schedules, the vibration map, trained networks.

``catalogue`` finds one by its name or file. Imports rollouts and records; torch for trained networks and for fitting the map alone.
"""
