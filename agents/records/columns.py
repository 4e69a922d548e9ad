"""What an episode, a design and a metre are described by in tables: the only list of KPIs, which others choose from.

A table that was stored before there was a KPI has no column of it. Readers demand ``CORE`` alone, and show of ``KPIS``
what a table has: a new KPI is an entry here, and what is stored stays readable.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from probe_env.envs.task import COSTS

Kpis = dict[str, tuple[str, float, str]]
"""KPI -> name, factor and unit for people."""

DETECTION: Final[Kpis] = {
    "a90_percent_wall": ("a90", 1.0, "% wall"),
    "length_with_snr_over_3_m": ("length with S/N over 3", 1.0, "m"),
    "noise_peak_to_peak_v": ("noise peak to peak", 1.0, "V"),
}
"""What would be found: of episodes since there is a sensor."""
KPIS: Final[Kpis] = {
    "reward": ("reward", 1.0, ""),
    "inspection_time_s": ("inspection time", 1.0, "s"),
    "share_within_limit": ("length within the limit", 100.0, "%"),
    "inspected_share": ("length inspected", 100.0, "%"),
    "radial_rms_m": ("radial rms", 1e3, "mm"),
    "radial_p99_m": ("radial p99", 1e3, "mm"),
    "radial_acceleration_rms_m_per_s2": ("radial acceleration rms", 1.0, "m/s2"),
    "air_m3": ("air used", 1.0, "m3"),
    **DETECTION,
}
"""All that tables of episodes show, in their order."""
CORE: Final = ("reward", "inspection_time_s", "share_within_limit", "radial_rms_m")
"""Every table of episodes has these: rankings, comparisons and pictures need them."""
CORE_FAILURES: Final = ("lost_drive", "diverged")
"""Alike, how episodes fail. An ending that is newer than a table ended none of its episodes."""
_SAID: Final = {"lost_drive": "lost their drive"}
"""What sentences say of episodes that failed so, where the name of the ending does not do."""
HIGH: Final = ("reward", "share_within_limit", "inspected_share", "length_with_snr_over_3_m")
"""KPIs of which more is better."""
COST_KPIS: Final = ("cost", *(f"cost_{name}" for name in COSTS))
"""Unsafe periods of an episode and their parts; episodes that were stored before there were costs have none."""
OVER_TUBES: Final[Kpis] = {"a90_95_percent_wall": ("a90/95", 1.0, "% wall")}
"""Figures of all tubes of a policy, no means."""
OF_DESIGNS: Final[Kpis] = {
    **{name: KPIS[name] for name in ("reward", "radial_rms_m", "share_within_limit", "inspection_time_s")},
    "inspected_m": ("inspected", 1.0, "m"),
    "drive_margin_n": ("drive margin", 1.0, "N"),
    **{name: DETECTION[name] for name in ("a90_percent_wall", "length_with_snr_over_3_m")},
}
"""What tables of designs show, in their order; what would be found only of whole insertions."""


def label_of(failure: str) -> str:
    """What tables say of an episode that failed so."""
    return failure.replace("_", " ")


def sentence_of(failure: str) -> str:
    """What sentences say of episodes that failed so: "2 lost their drive"."""
    return _SAID.get(failure, label_of(failure))


def kpis_of(columns: Iterable[str], known: Kpis = KPIS) -> Kpis:
    """The KPIs that a table with these columns has of every episode; of designs with ``OF_DESIGNS``."""
    names = set(columns)
    return {name: shown for name, shown in known.items() if name in names}


def shown_of(columns: Iterable[str]) -> Kpis:
    """All that a table of episodes with these columns shows of a policy."""
    kpis = kpis_of(columns)
    return kpis | (OVER_TUBES if "a90_percent_wall" in kpis else {})


CARRIED = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n")
"""Columns of an episode's profile, SI units."""
HEARD = ("noise_rms_m",)
"""Alike, of episodes that were stored since there is a sensor: noise in the band of a flaw, as radial rms."""
