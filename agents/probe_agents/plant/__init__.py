"""Logs of inspection rigs, calibration of a plant from them, schedules for it, and its control law for a PLC."""

from typing import TYPE_CHECKING

from probe_env.lazy import lazy

if TYPE_CHECKING:
    from probe_agents.plant.calibration import Calibration, calibrate, read_cases
    from probe_agents.plant.cleaning import Bounds
    from probe_agents.plant.logs import Log, read_log
    from probe_agents.plant.plc_export import structured_text
    from probe_agents.plant.recommendation import optimal_schedule
    from probe_agents.plant.response import stored_response
    from probe_agents.records.cells import ReadOptions
    from probe_agents.records.reader import read_schedule

__all__ = [
    "Bounds", "Calibration", "Log", "ReadOptions", "calibrate", "optimal_schedule", "read_cases", "read_log",
    "read_schedule", "stored_response", "structured_text",
]  # fmt: skip
__getattr__, __dir__ = lazy(__name__)
