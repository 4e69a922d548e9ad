"""What a metre of insertion feels like: channels of a log over length, feed, air, tube and what is not known of it.

A small network learnt from wandering insertions (``bank``). The root tension is told as the closed form of steady
sliding times what the network found to be off from it; the other channels as they are. How far insertions stray from
that, alike over metres and channels, is kept with it: the motion is chaotic, so a log is judged by that scatter.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular

from agents.calibration.metres import CHANNELS, Metres
from agents.records.arrays import read_arrays
from agents.records.atomic import write_atomically
from agents.records.reading import FileError
from probe_env import Scene
from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms import drag_per_metre, sliding_tension
from probe_env.physics.model.chain import air_speed

STORED: Final = Path(__file__).parent / "data" / "response.npz"
FLOORS: Final = np.array([1e-2, 0.1, 0.4, 2e-6])
"""Of each channel in SI units, added as root of the squares (the tension is cut off): less is not told apart.

Found on 48 simulated logs at ``standard``. With a response learnt at ``fast``, which shows twice the unrest of feeding,
those of the accelerations had to be five times as high."""
INPUTS: Final = 10
LAYERS: Final = 3
FAREST: Final = 10.0
"""Standard deviations that a metre counts for at most where a misfit is looked for."""
FRICTION, STIFFNESS, DRAG, DAMPING = range(4)
"""Columns of what is not known, in the order of ``unknowns.UNKNOWNS``."""
SHAPES: Final = {
    "scaling": (2, INPUTS),
    "ranges": (2, 5),
    "alike": (3, len(CHANNELS), len(CHANNELS)),
    "reach": (2,),
    "misfit": (len(CHANNELS) + 1,),
}


@dataclass(frozen=True, eq=False)
class Response:
    """Log-normal distribution of each channel of a metre.

    Attributes:
        layers: weights (inputs, outputs) and biases (outputs,), tanh between them.
        scaling: (2, 10) centre and spread of the inputs.
        ranges: (2, 5) least and greatest inserted length [m], feed speed [m/s], pull of the air on a metre [N/m],
            helix diameter [m] and radial room of the floats [m] that it was learnt from.
        alike: (3, c, c) covariance of the standardised strays of channels: what metres ``reach[0]`` apart still have
            in common, those ``reach[1]`` apart, and nothing.
        reach: (2,) [m].
        misfit: (c + 1,) how large the mean square of the strays of a channel, and of all, is in one of a hundred
            simulated logs.
    """

    layers: tuple[tuple[FloatArray, FloatArray], ...]
    scaling: FloatArray
    ranges: FloatArray
    alike: FloatArray
    reach: FloatArray
    misfit: FloatArray

    def tells(self, table: FloatArray, metres: Metres, scene: Scene) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (n, m, c) of the decadic logarithm of the channels (``CHANNELS``, SI units).

        Args:
            table: (n, 4) friction, contact stiffness [N/m], drag coefficient, damping time [s].
            metres: m metres.
            scene: tube, probe and air; what ``table`` holds is taken from there.
        """
        inputs, tension = inputs_of(table, metres, scene)
        values = (inputs - self.scaling[0]) / self.scaling[1]
        for weights, biases in self.layers[:-1]:
            values = np.tanh(values @ weights + biases)
        weights, biases = self.layers[-1]
        values = (values @ weights + biases).astype(float)
        mean, spread = values[..., : len(CHANNELS)], values[..., len(CHANNELS) :]
        mean[..., 0] += np.log10(tension)
        return mean, np.exp(np.clip(spread, -6.0, 1.0))

    def outside(self, metres: Metres, scene: Scene) -> list[str]:
        """What of a log lies beyond what it was learnt from, one sentence each."""
        sentences = []
        inputs = (metres.length, metres.feed, _pull(metres, scene), *(np.array([v]) for v in _geometry(scene)))
        names = (
            ("inserted length", "m"), ("feed speed", "m/s"), ("pull of the air", "N/m"), ("helix diameter", "m"),
            ("radial room of the floats", "m"),
        )  # fmt: skip
        for (name, unit), values, low, high in zip(names, inputs, *self.ranges, strict=True):
            if len(values) and (values.min() < low * (1.0 - 1e-3) or values.max() > high * (1.0 + 1e-3)):
                sentences.append(
                    f"{name} {values.min():.4g} to {values.max():.4g} {unit}, beyond {low:.4g} to {high:.4g}"
                )
        standard = Scene().probe
        others = [
            name
            for name in type(standard).model_fields
            if name != "damping_time" and getattr(scene.probe, name) != getattr(standard, name)
        ]
        return sentences + ([f"a probe of another {', '.join(others)}"] if others else [])

    def covariance(self, length: FloatArray, chosen: list[int]) -> FloatArray:
        """(m c, m c) of the standardised strays of metres at inserted lengths (m,) [m], for some channels."""
        apart = np.abs(length[:, None] - length)
        kernels = (*(np.exp(-apart / reach) for reach in self.reach), np.eye(len(length)))
        part = np.ix_(chosen, chosen)
        return np.asarray(sum(np.kron(k, alike[part]) for k, alike in zip(kernels, self.alike, strict=True)))

    def misfit_of(self, strays: FloatArray, length: FloatArray, chosen: list[int]) -> FloatArray:
        """(c + 1,) mean square of what metres stray from what they have alike: of every channel, and of all.

        Args:
            strays: (m, c) of some channels [standard deviations].
            length: (m,) [m].
            chosen: which channels; of the others it is NaN.
        """
        strays = np.clip(strays, -FAREST, FAREST)
        misfit = np.full(len(CHANNELS) + 1, np.nan)
        for column, k in enumerate(chosen):
            own = np.linalg.cholesky(self.covariance(length, [k]))
            misfit[k] = (solve_triangular(own, strays[:, column], lower=True) ** 2).mean()
        whole = np.linalg.cholesky(self.covariance(length, chosen))
        misfit[-1] = (solve_triangular(whole, strays.ravel(), lower=True) ** 2).mean()
        return misfit

    @classmethod
    def load(cls, path: Path = STORED) -> Response:
        """Read a stored one (plain arrays).

        Raises:
            FileNotFoundError: no such file.
            FileError: other arrays than it has.
        """
        arrays = read_arrays(path, lambda name: "f" if name in SHAPES or name[:-1] in ("weights", "biases") else "")
        sizes = [INPUTS]
        for k in range(LAYERS):
            weights, biases = (arrays.get(f"{part}{k}", np.zeros(())) for part in ("weights", "biases"))
            sizes.append(weights.shape[-1] if weights.ndim == 2 and k < LAYERS - 1 else 2 * len(CHANNELS))
            if weights.shape != (sizes[-2], sizes[-1]) or biases.shape != (sizes[-1],):
                raise FileError(path, f"layer {k}: missing, or of another shape")
        for name, shape in SHAPES.items():
            if name not in arrays or arrays[name].shape != shape:
                raise FileError(path, f"{name}: missing, or of another shape than {shape}")
        layers = tuple((arrays[f"weights{k}"], arrays[f"biases{k}"]) for k in range(LAYERS))
        return cls(layers, **{name: arrays[name].astype(float) for name in SHAPES})

    def save(self, path: Path) -> None:
        """Write it atomically."""
        arrays = {f"weights{k}": w for k, (w, _) in enumerate(self.layers)}
        arrays |= {f"biases{k}": b for k, (_, b) in enumerate(self.layers)}
        buffer = io.BytesIO()
        np.savez(buffer, **arrays, **{name: getattr(self, name) for name in SHAPES})  # type: ignore[arg-type]
        write_atomically(path, buffer.getvalue())


def inputs_of(table: FloatArray, metres: Metres, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Inputs (n, m, 10) of the network, and the tension of steady sliding (n, m) [N]; arguments of ``tells``."""
    count, pull = len(table), _pull(metres, scene)
    diameter, room = _geometry(scene)
    unit = scene.air.drag_coefficient
    drag = table[:, None, DRAG] / unit
    seen = {
        "inserted_length": metres.length, "feed_speed": metres.feed, "air_supply_rate": metres.air,
        "helix_diameter": np.full(len(metres), diameter),
    }  # fmt: skip
    friction = table[:, None, FRICTION]
    tension = np.maximum(drag * sliding_tension(friction, seen, scene), FLOORS[0])
    of_metre = (
        metres.length / 30.0,
        np.log(metres.feed),
        np.full(len(metres), np.log(diameter)),
        np.full(len(metres), 1e3 * room),
    )
    columns = [
        *(np.broadcast_to(values, (count, len(metres))) for values in of_metre),
        np.log(drag * pull),
        np.log(tension),
        np.broadcast_to(friction, (count, len(metres))),
        np.broadcast_to(np.log(table[:, None, STIFFNESS]), (count, len(metres))),
        np.broadcast_to(np.log(table[:, None, DAMPING]), (count, len(metres))),
        np.tanh(friction * metres.length / diameter),
    ]
    return np.stack(columns, axis=-1), tension


def observed(metres: Metres, chosen: list[int]) -> FloatArray:
    """(m, c) decadic logarithm of what some channels felt."""
    return np.column_stack([_felt(metres, k) for k in chosen])


def _felt(metres: Metres, channel: int) -> FloatArray:
    values = metres.felt[CHANNELS[channel]]
    floored = np.maximum(values, FLOORS[0]) if channel == 0 else np.hypot(values, FLOORS[channel])
    return np.asarray(np.log10(floored))


def _pull(metres: Metres, scene: Scene) -> FloatArray:
    """Of the air on a metre of carrier (m,) [N/m], (10)."""
    wind = metres.air * air_speed(scene, 1.0) - metres.feed
    return np.maximum(drag_per_metre(scene) * wind * np.abs(wind), 1e-3)


def _geometry(scene: Scene) -> tuple[float, float]:
    """Helix diameter and radial room of the carrier's floats [m]."""
    return scene.tube.helix_diameter, scene.tube.inner_diameter - scene.probe.carrier_float_diameter


@lru_cache
def stored_response() -> Response:
    """The shipped one."""
    return Response.load()
