"""Named axes along which a task is disturbed, and the values on each; no policy is told of any."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from agents.policies.places import with_probe
from probe_env.envs.task import TaskConfig

NOMINAL: Final = "nominal"
DELAYS: Final = (1.0, 2.0, 3.0)  # [s]
DROPOUT: Final = 0.2
DRIFT: Final = 0.3
OVALITY: Final = 0.1
BORE_SHARE: Final = 0.4
"""Of the clearance between bore and largest float, that another bore has less or more."""
PROBE: Final = "improved"
AXES: Final[dict[str, str]] = {
    "delay": "observations that come late",
    "noise": "sensor noise of eddy current and root tension",
    "dropout": "share of periods in which these two keep their last value",
    "air lag": "time constant of the air supply",
    "friction drift": "change of the friction from the entrance to the helix's end, around the tube's own",
    "oval tube": "less room in the plane of the helix",
    "probe": "another probe",
    "bore": "another inner diameter",
}
"""Name -> what is disturbed."""


class Disturbed(NamedTuple):
    """A task with one thing changed.

    Attributes:
        axis: ``NOMINAL``, or a name of ``AXES``.
        value: what it is changed to, for people; empty for the task itself.
        config: the task.
    """

    axis: str
    value: str
    config: TaskConfig

    @property
    def name(self) -> str:
        """For tables and folders."""
        return f"{self.axis} {self.value}".strip()


def disturbed(config: TaskConfig, axes: tuple[str, ...] = tuple(AXES)) -> list[Disturbed]:
    """The task itself, then every value of the axes.

    Raises:
        ValueError: there is no such axis, or one is named twice.
    """
    unknown = [axis for axis in axes if axis not in AXES]
    if unknown or len(set(axes)) < len(axes):
        raise ValueError(f"axes = {', '.join(axes)}: accepted, once each, are {', '.join(AXES)}")
    settings = [Disturbed(NOMINAL, "", config)]
    for axis in axes:
        settings += [
            Disturbed(axis, value, config.model_copy(update=changes)) for value, changes in _values(axis, config)
        ]
    return settings


def _values(axis: str, config: TaskConfig) -> list[tuple[str, dict[str, Any]]]:
    """Values of an axis in words, and what each changes of the task."""
    if axis == "delay":
        late = {seconds: max(round(seconds / config.period), 1) for seconds in DELAYS}
        return [(f"{s:g} s", {"delay_periods": config.delay_periods + periods}) for s, periods in late.items()]
    if axis == "noise":
        noises = ("rf_noise", "tension_noise")
        return [("doubled", {name: min(2.0 * getattr(config, name), 1.0) for name in noises})]
    if axis == "dropout":
        return [(f"{100.0 * DROPOUT:g} %", {"sensor_dropout": DROPOUT})]
    if axis == "air lag":
        return [("doubled", {"air_lag": 2.0 * config.air_lag})]
    if axis == "friction drift":
        return [
            (f"{100.0 * -drift:+g} % to {100.0 * drift:+g} %", {"friction_drift": drift}) for drift in (DRIFT, -DRIFT)
        ]
    if axis == "probe":
        return [(PROBE, {"scene": with_probe(config, PROBE).scene})]
    return _bores(axis, config)


def _bores(axis: str, config: TaskConfig) -> list[tuple[str, dict[str, Any]]]:
    """Tubes of another cross-section, in which the scene's probe fits."""
    tube, probe = config.scene.tube, config.scene.probe
    room = tube.clear_diameter - max(probe.carrier_float_diameter, probe.guide_float_diameter)
    if axis == "oval tube":
        ovality = tube.ovality + min(OVALITY, room / tube.inner_diameter)
        return [(f"{100.0 * ovality:.3g} %", {"scene": {"tube": {"ovality": ovality}}})]
    bores = (tube.inner_diameter + sign * BORE_SHARE * room for sign in (-1.0, 1.0))
    return [(f"{1e3 * bore:.1f} mm", {"scene": {"tube": {"inner_diameter": bore}}}) for bore in bores]
