"""Probes that are simulated: a scene and targets enter, samples of their motion leave; one probe, or many side by side.

Imports the methods and the model, scenes, settings, errors and the machine's cores.
"""
