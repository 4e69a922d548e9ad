"""What a worker tells of an insertion and what it can be told: plain data that crosses a pipe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from agents.evaluation.plan import Playing, Unit
from probe_env.arrays import FloatArray
from probe_env.envs.pictures.strip import Motion
from probe_env.envs.task.observations import in_si_units
from probe_env.inspection.sensor import Sensor
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.simulator import Simulator

OF_INFO: Final = (
    "time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n",
    "target_feed_speed", "target_air_supply_rate",
)  # fmt: skip
COLUMNS: Final = (*OF_INFO, "reward")
"""Of a row a control period, SI units; the reward is that of the episode up to then."""
Do = Literal["go", "pause", "step", "stop", "pace", "watch", "look", "hand"]


class Order(NamedTuple):
    """What a worker is told while it plays.

    Attributes:
        do: go on, pause, a single period, stop; "pace": so many periods a second, 0 for as fast as it goes; "watch":
            the insertion of this number; "look": slow motion of what comes; "hand": feed speed [m/s] and air [m3/s].
        values: of those that have some.
    """

    do: Do
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class Shape:
    """The probe that is watched, at the end of a period; its f floats from the entrance inwards.

    Attributes:
        place: (f,) of the unstretched probe from the entrance [m].
        axial, radial: (f,) displacement [m]; radial less than 0 presses on the inner wall.
        tension: (f,) axial force in the cable on the entrance's side [N].
        lever: (f,) half the diameter of the float [m].
        outer_gap: (f,) radial displacement at which it touches the outer wall [m]; infinite without that wall.
        sensor: which of the places is nearest to the sensor.
        bore, helix_length, helix_diameter: of the tube [m].
        friction: of the tube [-].
        signal_time, signal_radial: (m,) of the sensor in the last second of its motion [s], [m].
        spectrum: density of that motion as the filter weighs by it, at ``inspection.spectrum.FREQUENCY`` [m2/Hz].
        feed_speed: at the end of the period [m/s].
        seen: what the policy decides by next, SI units.
    """

    place: FloatArray
    axial: FloatArray
    radial: FloatArray
    tension: FloatArray
    lever: FloatArray
    outer_gap: FloatArray
    sensor: int
    bore: float
    helix_length: float
    helix_diameter: float
    friction: float
    signal_time: FloatArray
    signal_radial: FloatArray
    spectrum: FloatArray
    feed_speed: float
    seen: dict[str, float]


@dataclass(frozen=True)
class Frame:
    """Where a run is.

    Attributes:
        units: that are being played.
        watched: which of them is in ``shape``.
        rows: unit and (p, columns) periods since the last frame, of all that were played.
        shape: None: the watched one has ended, nothing else began.
        done, planned: episodes.
        paused: whether it waits to be told to go on.
    """

    units: tuple[Unit | None, ...]
    watched: int
    rows: tuple[tuple[Unit, FloatArray], ...]
    shape: Shape | None
    done: int
    planned: int
    paused: bool


@dataclass(frozen=True)
class Planned:
    """A run has begun.

    Attributes:
        episodes: that it has.
        notes: what was said of its policies.
        limit: of the radial rms [m]; None: the task's is one of another measure.
        sensor: what motion does to the signals.
    """

    episodes: int
    notes: tuple[str, ...]
    limit: float | None
    sensor: Sensor


@dataclass(frozen=True)
class Over:
    """A run has ended: how, and why if it failed."""

    state: Literal["finished", "stopped", "failed"]
    problem: str = ""


Message = Planned | Frame | Motion | Over


def row_of(playing: Playing, k: int) -> tuple[float, ...]:
    """The last period of a probe, see ``COLUMNS``."""
    assert playing.last is not None
    info = playing.last.infos[k]
    return (*(float(info[name]) for name in OF_INFO), playing.episodes.tally[k].reward)


def shape_of(playing: Playing, k: int) -> Shape:
    """A probe at the end of its last period."""
    episodes = playing.episodes
    simulator: Simulator = episodes.batch.simulators[k]
    chain, root, scene = simulator.chain, simulator.root, simulator.scene
    nodes = np.flatnonzero(chain.contact_stiffness[: root + 1] > 0.0)[::-1]
    radial = episodes.gauges.meter.last_second(k)
    seen = in_si_units(episodes.config, playing.observed(k))
    return Shape(
        place=(root - nodes) * chain.element_length,
        axial=simulator.state.d[nodes, 0],
        radial=simulator.state.d[nodes, 1],
        tension=simulator.state.axial_force[np.minimum(nodes, root - 1)],
        lever=chain.lever[nodes],
        outer_gap=chain.outer_gap[nodes],
        sensor=int(np.abs(nodes - simulator.sensor).argmin()),
        bore=scene.tube.inner_diameter,
        helix_length=scene.tube.helix_length,
        helix_diameter=scene.tube.helix_diameter,
        friction=scene.contact.friction,
        signal_time=SAMPLE_PERIOD * (np.arange(len(radial)) + 1 - len(radial)),
        signal_radial=radial,
        spectrum=episodes.gauges.meter.of_filter(k),
        feed_speed=simulator.feed_speed,
        seen={name: float(values[0]) for name, values in seen.items()},
    )
