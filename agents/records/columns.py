"""What an episode and a metre of it are told by."""

from __future__ import annotations

from typing import Final

KPIS: Final[dict[str, tuple[str, float, str]]] = {
    "reward": ("reward", 1.0, ""),
    "inspection_time_s": ("inspection time", 1.0, "s"),
    "share_within_limit": ("length within the limit", 100.0, "%"),
    "inspected_share": ("length inspected", 100.0, "%"),
    "radial_rms_m": ("radial rms", 1e3, "mm"),
    "radial_p99_m": ("radial p99", 1e3, "mm"),
    "radial_acceleration_rms_m_per_s2": ("radial acceleration rms", 1.0, "m/s2"),
    "air_m3": ("air used", 1.0, "m3"),
}
"""KPI -> name, factor and unit for people."""

CARRIED = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n")
"""Columns of an episode's profile, SI units."""
