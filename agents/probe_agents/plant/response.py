"""Expected measurements per metre of insertion: a small network of feed, air, tube and unknown parameters.

Trained on simulated insertions. It predicts the root tension relative to steady sliding, the other channels directly,
with their scatter (the motion is chaotic) and its correlation over metres and channels.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular

from probe_agents.plant.logs import Log
from probe_agents.records.atomic import write_atomically
from probe_agents.records.quantities import MEASURED, QUANTITIES
from probe_env import Scene
from probe_env.arrays import FloatArray
from probe_env.envs.vibration_map import Layers, distribution_of
from probe_env.files import FileError, read_arrays
from probe_env.physics.closed_forms import drag_per_metre, entrance_tension, sliding_tension
from probe_env.physics.model.chain import air_speed

STORED: Final = Path(__file__).parent / "data" / "response.npz"
CHANNELS: Final = MEASURED[:4]
RESTART: Final = 3.0
"""Time after a standstill that is ignored [s]: the probe accelerates."""
MIN_FED: Final = 0.5
"""Least share of a metre with feed; other metres are ignored."""
FLOORS: Final = np.array([1e-2, 0.1, 0.4, 2e-6])
"""Resolution of each channel in SI units, added as root of squares (the tension is clipped).

Found on 48 simulated logs at ``standard``. A response trained at ``fast``, with twice the vibration
from feeding, needs five times the values for the accelerations."""
INPUTS, HIDDEN, LAYERS = 10, 64, 3
MIN_SPREAD: Final = -6.0  # least logarithm of a standard deviation [decades]
MAX_DEVIATION: Final = 10.0
"""Deviations are clipped here in misfits [standard deviations]."""
FRICTION, STIFFNESS, DRAG, DAMPING = range(4)
"""Columns of tables of unknowns, in the order of ``prior.UNKNOWNS``."""
SHAPES: Final = {
    "scaling": (2, INPUTS),
    "ranges": (2, 5),
    "alike": (3, len(CHANNELS), len(CHANNELS)),
    "reach": (2,),
    "misfit": (len(CHANNELS) + 1,),
}
"""Array of the file -> shape."""
ATTRIBUTES: Final = {"alike": "shared_covariance"}
"""Array of the file -> attribute, where they differ."""
SIZES: Final = (INPUTS, *[HIDDEN] * (LAYERS - 1), 2 * len(CHANNELS))
STORED_SHAPES: Final[dict[str, tuple[int, ...]]] = (
    {f"weights{k}": SIZES[k : k + 2] for k in range(LAYERS)}
    | {f"biases{k}": SIZES[k + 1 : k + 2] for k in range(LAYERS)}
    | SHAPES
)


@dataclass(frozen=True, eq=False)
class Metres:
    """Means of a log over each metre of inserted length with feed, (m,) each."""

    length: FloatArray  # inserted, at their middle [m]
    feed: FloatArray  # [m/s]
    air: FloatArray  # [m3/s]
    measured: dict[str, FloatArray]  # mean tension [N] and pressure [Pa], rms of accelerations [m/s2] and noise [m]

    def __len__(self) -> int:
        return len(self.length)


def metres_of(log: Log, min_feed: float = 0.0) -> Metres:
    """Average a log over metres: means over time, root mean squares for rms channels.

    Rows with a feed of at most ``min_feed`` [m/s], the following ``RESTART``, and metres of which less than ``MIN_FED``
    remains are ignored.
    """
    names = [name for name in MEASURED if name in log.measured]
    lasts = np.diff(log.time, append=log.time[-1] + (log.time[-1] - log.time[-2] if len(log.time) > 1 else 1.0))
    stood = np.where(log.feed_speed <= min_feed, log.time + lasts, -np.inf)
    since = log.time - np.maximum.accumulate(stood)
    fed = log.feed_speed * lasts
    good = (log.feed_speed > min_feed) & (since >= RESTART)
    metre = np.floor(log.inserted_length + 0.5 * fed).astype(int)[good]
    first = int(metre.min(initial=0))  # there may be no metre with feed
    seconds = np.bincount(metre - first, lasts[good])
    through = np.bincount(metre - first, fed[good])
    complete = through >= MIN_FED

    def mean(values: FloatArray, rms: bool = False) -> FloatArray:
        weighed = (
            np.bincount(metre - first, lasts[good] * values[good] ** (2 if rms else 1))[complete] / seconds[complete]
        )
        return np.asarray(np.sqrt(weighed) if rms else weighed)

    length = np.arange(first, first + len(complete))[complete] + 0.5
    means = {name: mean(log.measured[name], QUANTITIES[name].rms) for name in names}
    return Metres(length, through[complete] / seconds[complete], mean(log.air_supply_rate), means)


@dataclass(frozen=True, eq=False)
class Response:
    """Log-normal distribution of each channel of a metre.

    Attributes:
        layers: of its network.
        scaling: (2, 10) centre and spread of the inputs.
        ranges: (2, 5) smallest and largest inserted length [m], feed speed [m/s], pull of the air on a metre [N/m],
            helix diameter [m] and radial room of the floats [m] in training.
        shared_covariance: (3, c, c) covariance of the standardised deviations of channels: the part that decays over
            ``reach[0]``, the part that decays over ``reach[1]``, and the part of each metre alone.
        reach: (2,) [m].
        misfit: (c + 1,) 99th percentile over simulated logs of the mean squared deviation of each channel, and of all.
    """

    layers: Layers
    scaling: FloatArray
    ranges: FloatArray
    shared_covariance: FloatArray
    reach: FloatArray
    misfit: FloatArray

    def predict(self, table: FloatArray, metres: Metres, scene: Scene) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (n, m, c) of the decadic logarithm of the channels (``CHANNELS``, SI units).

        Args:
            table: (n, 4) friction, contact stiffness [N/m], drag coefficient, damping time [s].
            metres: m metres.
            scene: tube, probe and air, except for the values in ``table``.
        """
        inputs, tension = inputs_of(table, metres, scene)
        mean, spread = distribution_of(self.layers, (inputs - self.scaling[0]) / self.scaling[1], MIN_SPREAD)
        mean[..., 0] += np.log10(tension)
        return mean, spread

    def outside(self, metres: Metres, scene: Scene) -> list[str]:
        """Texts for everything in a log that is outside the training ranges."""
        texts = []
        named = (
            ("inserted length", metres.length, "m"),
            ("feed speed", metres.feed, "m/s"),
            ("pull of the air", _pull(metres, scene), "N/m"),
            ("helix diameter", np.array([scene.tube.helix_diameter]), "m"),
            ("radial room of the floats", np.array([_room(scene)]), "m"),
        )
        for (name, values, unit), low, high in zip(named, *self.ranges, strict=True):
            if len(values) and (values.min() < low * (1.0 - 1e-3) or values.max() > high * (1.0 + 1e-3)):
                texts.append(f"{name} {values.min():.4g} to {values.max():.4g} {unit}, beyond {low:.4g} to {high:.4g}")
        standard, probe = Scene().probe.model_dump(), scene.probe.model_dump()
        others = [name for name in standard if name != "damping_time" and probe[name] != standard[name]]
        texts += [f"probe with different {', '.join(others)}"] if others else []
        texts += [] if scene == scene.whole() else ["assumptions = 'study' of the plant: it is of the whole model"]
        return texts

    def covariance(self, length: FloatArray, chosen: list[int]) -> FloatArray:
        """(m c, m c) of the standardised deviations of metres at inserted lengths (m,) [m], for some channels."""
        apart = np.abs(length[:, None] - length)
        kernels = (*(np.exp(-apart / reach) for reach in self.reach), np.eye(len(length)))
        part = np.ix_(chosen, chosen)
        return np.asarray(
            sum(np.kron(k, shared[part]) for k, shared in zip(kernels, self.shared_covariance, strict=True))
        )

    def misfit_of(self, deviations: FloatArray, length: FloatArray, chosen: list[int]) -> FloatArray:
        """(c + 1,) mean squared decorrelated deviation of every channel, and of all; NaN for channels not chosen.

        Args:
            deviations: (m, c) deviations of the chosen channels [standard deviations].
            length: (m,) [m].
            chosen: their indices.
        """
        deviations = np.clip(deviations, -MAX_DEVIATION, MAX_DEVIATION)
        misfit = np.full(len(CHANNELS) + 1, np.nan)
        for column, k in enumerate(chosen):
            factor = np.linalg.cholesky(self.covariance(length, [k]))
            misfit[k] = (solve_triangular(factor, deviations[:, column], lower=True) ** 2).mean()
        whole = np.linalg.cholesky(self.covariance(length, chosen))
        misfit[-1] = (solve_triangular(whole, deviations.ravel(), lower=True) ** 2).mean()
        return misfit

    @classmethod
    def load(cls, path: Path = STORED) -> Response:
        """Read a stored response; missing arrays and wrong shapes are refused."""
        arrays = read_arrays(path, lambda name: "f" if name in STORED_SHAPES else "")
        for name, shape in STORED_SHAPES.items():
            if name not in arrays or arrays[name].shape != shape:
                raise FileError(path, f"{name}: missing, or shape is not {shape}")
        layers = tuple((arrays[f"weights{k}"], arrays[f"biases{k}"]) for k in range(LAYERS))
        return cls(layers, **{ATTRIBUTES.get(name, name): arrays[name].astype(float) for name in SHAPES})

    def save(self, path: Path) -> None:
        """Write it as plain arrays, atomically."""
        arrays = {name: getattr(self, ATTRIBUTES.get(name, name)) for name in SHAPES}
        for k, (weights, biases) in enumerate(self.layers):
            arrays |= {f"weights{k}": weights, f"biases{k}": biases}
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        write_atomically(path, buffer.getvalue())


def steady_tension(friction: FloatArray, metres: Metres, scene: Scene, drag: FloatArray | float = 1.0) -> FloatArray:
    """Root tension (n, m) of steady sliding that the feed device feels [N]; friction and factor of the drag (n, 1)."""
    diameter = np.full(len(metres), scene.tube.helix_diameter)
    observation = {"inserted_length": metres.length, "feed_speed": metres.feed, "air_supply_rate": metres.air}
    tension = sliding_tension(friction, observation | {"helix_diameter": diameter}, scene, drag)
    return np.asarray(tension - entrance_tension(scene, diameter))


def inputs_of(table: FloatArray, metres: Metres, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Inputs (n, m, 10) of the network, and the tension of steady sliding (n, m) [N]; arguments of ``predict``."""
    diameter = scene.tube.helix_diameter
    friction, drag = table[:, None, FRICTION], table[:, None, DRAG] / scene.air.drag_coefficient
    tension = np.maximum(steady_tension(friction, metres, scene, drag), FLOORS[0])
    columns = (
        metres.length / 30.0,
        np.log(metres.feed),
        np.log(diameter),
        1e3 * _room(scene),
        np.log(drag * _pull(metres, scene)),
        np.log(tension),
        friction,
        np.log(table[:, None, STIFFNESS]),
        np.log(table[:, None, DAMPING]),
        np.tanh(friction * metres.length / diameter),
    )
    return np.stack([np.broadcast_to(values, tension.shape) for values in columns], axis=-1), tension


def observed(metres: Metres, chosen: list[int]) -> FloatArray:
    """(m, c) decadic logarithm of some measured channels."""
    columns = []
    for k in chosen:
        values = metres.measured[CHANNELS[k]]
        columns.append(np.log10(np.maximum(values, FLOORS[0]) if k == 0 else np.hypot(values, FLOORS[k])))
    return np.column_stack(columns)


def _pull(metres: Metres, scene: Scene) -> FloatArray:
    """Drag of the air on a metre of carrier (m,) [N/m], (10)."""
    wind = metres.air * air_speed(scene, 1.0) - metres.feed
    return np.maximum(drag_per_metre(scene) * wind * np.abs(wind), 1e-3)


def _room(scene: Scene) -> float:
    return scene.tube.inner_diameter - scene.probe.carrier_float_diameter


@lru_cache
def stored_response() -> Response:
    """Load the shipped response."""
    return Response.load()
