"""The study's claims: its cases enter, findings and pictures leave.

Imports records and the physics.
"""
