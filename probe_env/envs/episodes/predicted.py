"""Prediction of N insertions: a vibration map, closed forms and measured noise give the statistics of each period.

The surrogate is quasi-steady: vibration has no transients except its noise, and no probe diverges. Feed and air follow
their targets as in a simulation. Training takes minutes instead of hours; evaluate agents by simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import TypeAdapter

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.backend import Backend, StepRecord
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.observations import normal_draws
from probe_env.envs.task.rules import air_used
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, check_measure, rms_limit
from probe_env.physics.closed_forms import entrance_tension, sliding_tension
from probe_env.physics.model.drive import drives_after
from probe_env.physics.simulation.window import Window
from probe_env.scene import Scene

DRAWS: Final = 5
"""Normal draws per probe and period: slow and quick vibration, tension, two accelerations."""
SCATTERED: Final = (0, 2, 3, 4)
"""Draws of the processes that persist, see ``Predicted.processes``."""
WAVES: Final = 32
"""Number of cosines of a random field."""
DRIVE_STEP: Final = 5e-3
"""Time step of the feed and air dynamics [s]: the length error is 0.5 mm for a change of feed by 0.2 m/s."""
STORED: Final = Path(__file__).parents[2] / "data" / "surrogate-noise.json"


@dataclass(frozen=True)
class Scatter:
    """Stationary Gaussian AR(1) process: standard deviation, and correlation from one second to the next."""

    deviation: float = 0.0
    correlation: float = 0.0

    def next(self, value: FloatArray, normal: FloatArray) -> FloatArray:
        """The next second's values (n,), by standard normal draws (n,)."""
        return np.asarray(self.correlation * value + self.deviation * np.sqrt(1.0 - self.correlation**2) * normal)


@dataclass(frozen=True)
class RandomField:
    """What the map misses in a tube: a smooth random function of feed, air and length, Gaussian with these scales."""

    deviation: float = 0.0
    feed: float = 1.0  # in the natural logarithm of the feed
    air: float = 1.0  # [m3/s]
    length: float = 1.0  # [m]

    def waves(self, rng: np.random.Generator) -> FloatArray:
        """A random function as the sum of (``WAVES``, 4) cosines: a phase, and factors of the three variables."""
        scales = 1.0 / np.array([self.feed, self.air, self.length])
        return np.column_stack([rng.uniform(0.0, 2.0 * np.pi, WAVES), rng.normal(0.0, scales, (WAVES, 3))])

    def at(self, waves: FloatArray, feed: FloatArray, air: FloatArray, length: FloatArray) -> FloatArray:
        """Values (n,) of the functions ``waves`` (n, ``WAVES``, 4)."""
        variables = np.column_stack([np.ones_like(feed), np.log(feed), air, length])
        cosines = np.cos(np.einsum("nwv,nv->nw", waves, variables))
        return np.asarray(self.deviation * np.sqrt(2.0 / WAVES) * cosines.sum(axis=1))


@dataclass(frozen=True)
class Noise:
    """Scatter of a second of insertion about the map, in decades."""

    bias: float = 0.0  # rms of a second relative to that of a metre, which the map predicts
    field: RandomField = RandomField()  # deviation of a tube from the map, which persists while feed and air are kept
    slow: Scatter = Scatter()  # deviation from both, of some seconds
    quick: float = 0.0  # standard deviation of the radial rms from one second to the next
    tension: Scatter = Scatter()  # natural logarithm of the root tension over that of steady sliding
    radial: tuple[float, ...] = (1.0, 0.7, 0.0, 0.0, 0.0, 0.0)  # of log10 of the rms acceleration, see ``features``
    radial_scatter: Scatter = Scatter()
    axial: tuple[float, ...] = (1.0, 0.4, 0.0, 0.0, 0.0, 0.0)
    axial_scatter: Scatter = Scatter()


MEASURED: Final[Noise] = TypeAdapter(Noise).validate_json(STORED.read_bytes())
"""Result of ``probe-env study surrogate-noise``."""


def features(vibration: FloatArray, feed: FloatArray, length: FloatArray, tubes: FloatArray) -> FloatArray:
    """(n, 6) inputs of the accelerations from log10(radial rms / 0.1 mm), feed [m/s], inserted length [m] and tubes."""
    one = np.ones_like(vibration)
    friction, diameter = tubes[:, 0] / 0.175, 1.0 / tubes[:, 3]
    return np.column_stack([one, vibration, np.log10(np.maximum(feed, 1e-3)), length / 60.0, friction, diameter])


def product_of_rows(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Matrix product (n, i) (i, o), row by row: one product of all rows would round a row differently for each n."""
    return np.asarray(np.matmul(values[:, None, :], weights)[:, 0])


class Predicted(Backend):
    """Predicts N insertions from a vibration map, closed forms and measured noise.

    Args:
        count: N.
        config: the task.
        vibration: the map.
        noise: scatter about the map; default: as measured.
    """

    samples = False
    kernel_seconds = 0.0

    def __init__(self, count: int, config: TaskConfig, vibration: VibrationMap, noise: Noise = MEASURED) -> None:
        super().__init__(count, config)
        self.map, self.noise = vibration, noise
        self.tubes, self.waves = np.ones((count, len(CONTEXT))), np.zeros((count, WAVES, 4))
        self.length, self.feed, self.air = np.zeros(count), np.zeros(count), np.zeros(count)
        self.processes = (noise.slow, noise.tension, noise.radial_scatter, noise.axial_scatter)
        self.scatter = np.zeros((count, len(self.processes)))

    @property
    def inserted_length(self) -> FloatArray:
        """See ``Backend.inserted_length``."""
        return self.length

    def check(self, context: Context, scene: Scene) -> None:
        """See ``Backend.check``."""
        if scene.probe != self.map.scene.probe:
            raise ValueError("probe: the map is of another probe; simulate with fidelity fast or finer")
        for name, low, high in zip(CONTEXT, *self.map.ranges, strict=True):
            if not low - 1e-9 <= getattr(context, name) <= high + 1e-9:
                raise ValueError(
                    f"{name} = {getattr(context, name):g} is outside the map's range {low:g} to {high:g}: simulate with"
                    " fidelity fast or finer"
                )

    def begin(self, k: int, context: Context, scene: Scene, rng: np.random.Generator) -> None:
        """See ``Backend.begin``."""
        super().begin(k, context, scene, rng)
        self.tubes[k] = [getattr(context, name) for name in CONTEXT]
        self.length[k], self.feed[k], self.air[k] = scene.inserted_length, scene.feed_speed, scene.air_supply_rate
        self.waves[k] = self.noise.field.waves(rng)

    def settle(self, which: BoolArray, rngs: Sequence[np.random.Generator]) -> Window:
        """See ``Backend.settle``."""
        normal = normal_draws(rngs, which, DRAWS)
        for column, process in enumerate(self.processes):
            self.scatter[which, column] = process.deviation * normal[which, SCATTERED[column]]
        return self._window(normal)

    def advance(
        self, stepped: BoolArray, targets: FloatArray, direction: FloatArray, rngs: Sequence[np.random.Generator]
    ) -> StepRecord:
        """See ``Backend.advance``."""
        config, now = self.config, (self.feed, self.air, self.length)
        steps = max(round(config.period / DRIVE_STEP), 1)
        after = drives_after(steps, config.period / steps, config.ramp, config.air_lag, *now[:2], targets, now[2])
        self.feed, self.air, length = (np.where(stepped, new, old) for new, old in zip(after, now, strict=True))
        self.length = np.minimum(length, self.helix_length)
        normal = normal_draws(rngs, stepped, DRAWS + 2)
        for column, process in enumerate(self.processes):
            following = process.next(self.scatter[:, column], normal[:, SCATTERED[column]])
            self.scatter[stepped, column] = following[stepped]
        window = self._window(normal)
        return StepRecord(
            stepped=stepped,
            finite=stepped,
            length_before=now[2],
            length_after=self.length,
            helix_length=self.helix_length,
            air=np.where(stepped, air_used(config, now[1], self.air), 0.0),
            seconds=np.full(len(stepped), config.period),
            max_tension=window.statistics["tension_mean_n"],
            buckling_load=self.buckling_load,
            window=window,
            signals={},
            sensor_noise=normal[:, DRAWS:],
        )

    def _window(self, normal: FloatArray) -> Window:
        """Predicted statistics of a period, by standard normal draws (N, ``DRAWS`` or more)."""
        noise, scene, tubes = self.noise, self.config.scene, self.tubes
        length, feed = np.maximum(self.length, 1.0), np.maximum(self.feed, 1e-3)
        mean = self.map.predict(length, feed, self.air, tubes, scene, product_of_rows)[0]
        field = noise.field.at(self.waves, feed, self.air, length)
        slow, tension, radial, axial = self.scatter.T
        vibration = mean + noise.bias + field + slow + noise.quick * normal[:, 1]
        drive = {"inserted_length": length, "feed_speed": self.feed, "air_supply_rate": self.air}
        steady = sliding_tension(tubes[:, 0], drive | {"helix_diameter": tubes[:, 3]}, scene, tubes[:, 2])
        inputs = features(vibration, self.feed, length, tubes)
        statistics = {
            "radial_rms_m": 10.0**vibration * 1e-4,
            "tension_mean_n": steady * np.exp(tension) - entrance_tension(scene, tubes[:, 3]),
            "radial_acceleration_rms_m_per_s2": 10.0 ** ((inputs * noise.radial).sum(axis=1) + radial),
            "axial_acceleration_rms_m_per_s2": 10.0 ** ((inputs * noise.axial).sum(axis=1) + axial),
        }
        if self.map.measure == "snr":  # then the map predicts the noise in the band of a flaw
            one = self.config.sensor.equivalent_rms(np.ones(1))
            statistics["noise_to_signal"] = statistics["radial_rms_m"] / one
        state = self.length.copy(), self.feed.copy(), self.air.copy()
        return Window(statistics, *state, diverged=np.zeros(len(normal), dtype=bool))


def check_task(config: TaskConfig, probes: str, vibration: VibrationMap) -> None:
    """Raise ValueError if the map does not predict a task."""
    length, max_length = config.scene.tube.helix_length, vibration.scene.tube.helix_length
    mapped = vibration.scene.assumptions
    refused = {
        "growing = False": not config.growing,
        f"probes = {probes!r}": probes != "scene",
        "sensor_dropout": config.sensor_dropout > 0.0,
        "friction_drift": config.friction_drift != 0.0,
        **{f"{name} = {value!r}": value != mapped[name] for name, value in config.scene.assumptions.items()},
        f"helix_length = {length:g} m (the map ends at {max_length:g} m)": length > max_length * (1.0 + 1e-9),
    }
    wrong = [name for name, applies in refused.items() if applies]
    if wrong:
        raise ValueError(
            f"fidelity = 'surrogate' is for insertions of the vibration map (Insertion-v1), without"
            f" {', '.join(wrong)}: simulate with standard"
        )
    rms_limit(config)  # refuses a vibration measure that no map predicts
    check_measure(vibration, config)
