"""Probes that are simulated: a scene and targets enter, samples of their motion leave; one probe, or many side by side.

Imports the methods, the drive, the state, and what a run and a saved probe are.
"""
