"""Lines that are laid over a schedule: what policies that go by the length feed, and what a rig's log has fed."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from agents.plant.logs import read_log
from agents.policies.catalogue import BY_DIAMETER, STORED, make_policy
from agents.policies.fixed import FixedPolicy, Replayed
from agents.policies.maps.lookup import FIRST
from agents.policies.places import Place
from agents.records.shipped import file_or_shipped, shipped_names
from probe_env.arrays import FloatArray
from probe_env.schedule import Schedule

BY_LENGTH: Final = ("constant", "slow-down", *STORED, BY_DIAMETER, "privileged")
"""Policies that look at nothing but the inserted length, or are told the tube."""
STEP: Final = 0.25
"""Of the drawn lines [m]."""


class Line(NamedTuple):
    """Feed [m/s] and air [m3/s] over inserted length [m], (n,) each."""

    length: FloatArray
    feed: FloatArray
    air: FloatArray


def overlay_names() -> tuple[str, ...]:
    """What can be laid over by its name."""
    return (*BY_LENGTH, *shipped_names("schedules"))


def line_of(spec: str, place: Place) -> Line:
    """What a policy feeds in the first tube of a place; schedule files as well.

    Raises:
        FileNotFoundError: no such file.
        ValueError: no such policy, or one that decides by what it feels.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the device does not give is not in the line that is drawn
        policy = make_policy(spec, place.config.all_shown, place.vibration)
    if isinstance(policy, Replayed):
        return _over_length(policy.schedule)
    if not isinstance(policy, FixedPolicy) or (spec not in BY_LENGTH and not hasattr(policy, "schedule")):
        raise ValueError(f"policy = {spec!r} decides by what it feels: run it to see what it feeds")
    length = np.arange(FIRST, place.config.scene.tube.helix_length + 0.5 * STEP, STEP)
    tube = {name: np.full(len(length), value) for name, value in place.contexts[0].model_dump().items()}
    seen = tube | {"time": np.zeros(len(length)), "inserted_length": length}
    feed, air = place.config.given(*policy.targets(seen, np.zeros((len(length), policy.memory)))).T
    return Line(length, feed, air)


def line_of_log(path: Path) -> Line:
    """What a rig's log has fed; also one that ships, by its name.

    Raises:
        FileNotFoundError: no such file.
        FileError: it is no log, in one line.
    """
    log = read_log(file_or_shipped("logs", path))
    return Line(log.inserted_length, log.feed_speed, log.air_supply_rate)


def _over_length(schedule: Schedule) -> Line:
    """A schedule over time, from where it begins on."""
    length = (schedule.start_length or 0.0) + schedule.fed(schedule.position)
    return Line(length, np.array(schedule.feed_speed), np.array(schedule.air_supply_rate))
