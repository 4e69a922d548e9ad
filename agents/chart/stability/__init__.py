"""Where methods stop: methods, scenes and steps enter; what held, one mass's amplification, energy, digits leave.

Imports the chart's colours, records and the physics.
"""
