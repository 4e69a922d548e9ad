"""Logs of inspection rigs, calibration of a plant from them, schedules for it, and its control law for a PLC."""
