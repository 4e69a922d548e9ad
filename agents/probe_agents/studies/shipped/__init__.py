"""Studies that make the shipped data: vibration map, best schedules, calibration response and PLC constants."""
