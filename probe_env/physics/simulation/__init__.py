"""Simulators of one probe or of many, and the signals and statistics that they return."""
