"""What an episode and a metre of it are told by."""

from __future__ import annotations

from collections.abc import Iterable
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
FOUND: Final[dict[str, tuple[str, float, str]]] = {
    "a90_percent_wall": ("a90", 1.0, "% wall"),
    "length_with_snr_over_3_m": ("length with S/N over 3", 1.0, "m"),
    "noise_peak_to_peak_v": ("noise peak to peak", 1.0, "V"),
}
"""What would be found, alike; episodes that were stored before there was a sensor have none of it."""
COST_KPIS: Final = ("cost", "cost_lost_drive", "cost_tension", "cost_buckling")
"""Unsafe periods of an episode and their parts; episodes that were stored before there were costs have none."""
OVER_TUBES: Final[dict[str, tuple[str, float, str]]] = {"a90_95_percent_wall": ("a90/95", 1.0, "% wall")}
"""Figures of all tubes of a policy, no means."""


def kpis_of(columns: Iterable[str]) -> dict[str, tuple[str, float, str]]:
    """The KPIs that a table with these columns has of every episode."""
    known = set(columns)
    return KPIS | {name: told for name, told in FOUND.items() if name in known}


def shown_of(columns: Iterable[str]) -> dict[str, tuple[str, float, str]]:
    """All that is told of a policy by a table of episodes with these columns."""
    kpis = kpis_of(columns)
    return kpis | (OVER_TUBES if "a90_percent_wall" in kpis else {})


CARRIED = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n")
"""Columns of an episode's profile, SI units."""
HEARD = ("noise_rms_m",)
"""Alike, of episodes that were stored since there is a sensor: noise in the band of a flaw, as radial rms."""
