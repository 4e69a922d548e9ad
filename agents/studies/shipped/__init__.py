"""Makers of shipped data: vibration map, best schedules, calibration response and PLC constants."""
