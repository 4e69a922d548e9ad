"""The KPIs of episodes and designs: their columns, names and units."""

from collections.abc import Iterable
from typing import Final

from probe_env.envs.task.rules import COSTS

Kpis = dict[str, tuple[str, float, str]]
"""Column -> name, factor and unit in tables."""

DETECTION: Final[Kpis] = {
    "a90_percent_wall": ("a90", 1.0, "% wall"),
    "length_with_snr_over_3_m": ("length with S/N over 3", 1.0, "m"),
    "noise_peak_to_peak_v": ("noise peak to peak", 1.0, "V"),
}
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
"""KPIs of episodes, in the order of tables."""
OF_INSTRUMENT: Final[Kpis] = {
    "length_too_fast_m": ("length too fast", 1.0, "m"),
    "speed_excess_m_per_s": ("most above the permitted speed", 1.0, "m/s"),
    "length_sensor_too_fast_m": ("length too fast with axial vibration", 1.0, "m"),
    "length_to_repeat_m": ("length to repeat", 1.0, "m"),
}
"""KPIs of episodes of a plant with an instrument, after the others."""
GOALS: Final[Kpis] = {
    "total_hours": ("hours of all passes", 1.0, "h"),
    "total_time_s": ("time with second passes", 1.0, "s"),
}
"""KPI that policies are ranked by if the plant has a bundle, or an instrument alone; without both it is the reward."""
CORE: Final = ("reward", "inspection_time_s", "share_within_limit", "radial_rms_m")
"""KPIs that every table of episodes has."""
CORE_FAILURES: Final = ("lost_drive", "diverged")
"""Failures that are columns of every table of episodes."""
HIGH: Final = ("reward", "share_within_limit", "inspected_share", "length_with_snr_over_3_m")
"""KPIs for which larger is better."""
COST_KPIS: Final = ("cost", *(f"cost_{name}" for name in COSTS))
"""Number of unsafe control periods of an episode, in total and by cost."""
OVER_TUBES: Final[Kpis] = {"a90_95_percent_wall": ("a90/95", 1.0, "% wall")}
"""Figures of a policy over all tubes together, not means."""
OF_DESIGNS: Final[Kpis] = {
    **{name: KPIS[name] for name in ("reward", "radial_rms_m", "share_within_limit", "inspection_time_s")},
    "inspected_m": ("inspected in a whole insertion", 1.0, "m"),
    "drive_margin_n": ("drive margin", 1.0, "N"),
    "euler_margin": ("Euler margin", 1.0, ""),
    **{name: DETECTION[name] for name in ("a90_percent_wall", "length_with_snr_over_3_m")},
}
"""KPIs of designs, in the order of tables."""
PROFILE_COLUMNS: Final[tuple[str, ...]] = (
    "time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n", "noise_rms_m",
)  # fmt: skip
"""Columns of an episode's profile, SI units; ``noise_rms_m``: noise in the band of a flaw, as radial rms."""
PROFILE_COLUMNS_INSTRUMENT: Final = ("highest_feed", "axial_velocity_rms", "permitted_speed")
"""Columns of profiles with an instrument [m/s]: highest feed of a control period in the metre, rms of the sensor's
axial velocity about its mean (NaN: not simulated), and the permitted speed (NaN: no limit)."""
SCORED_PASSES: Final[dict[str, str]] = {
    "insertion": "the insertion", "withdrawal": "the withdrawal", "best": "the better of both"
}  # fmt: skip
"""Values of ``TaskConfig.scored_pass`` -> label."""


def heading(label: tuple[str, float, str]) -> str:
    """Heading of a column: name and unit."""
    name, _, unit = label
    return f"{name} [{unit}]" if unit else name


def label_of(failure: str) -> str:
    """Label of a failure in tables."""
    return failure.replace("_", " ")


def kpis_of(columns: Iterable[str], kpis: Kpis | None = None) -> Kpis:
    """The KPIs among the columns of a table (default: those of episodes); for designs with ``OF_DESIGNS``."""
    names, kpis = set(columns), GOALS | KPIS | OF_INSTRUMENT if kpis is None else kpis
    return {name: label for name, label in kpis.items() if name in names}


def goal_of(columns: Iterable[str]) -> str:
    """The KPI that the policies of a table with these columns are ranked by."""
    return next(iter(kpis_of(columns, GOALS)), "reward")


def displayed_kpis(columns: Iterable[str]) -> Kpis:
    """KPIs of a policy in a table of episodes with these columns, including those over all tubes."""
    kpis = kpis_of(columns)
    return kpis | (OVER_TUBES if "a90_percent_wall" in kpis else {})
