"""Vibration map: radial vibration by inserted length, feed, air and tube; a small network fitted to insertions.

The probe responds within a second or two to a change of feed or air, so the vibration at a length depends on the feed
and air there. The map therefore predicts the cost of any schedule in any tube: schedules are searched in seconds, a
controller that knows the tube can look up its best feed, and agents can train on it (see ``surrogate``).
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.envs.contexts import DRAG_FACTOR, FRICTION, HELIX_DIAMETERS, STIFFNESS
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import capped_square, metre_cost
from probe_env.files import FileError, read_arrays
from probe_env.physics.closed_forms import drag_per_metre
from probe_env.physics.model.chain import air_speed
from probe_env.scene import Scene
from probe_env.settings import errors_in

FEEDS: Final = (0.04, 0.4)  # [m/s]; slower feeds take most of the time and vibrate least
CONTEXT: Final = ("friction", "contact_stiffness", "drag_factor", "helix_diameter")
SHIPPED_RANGES: Final = np.array(
    [FRICTION, STIFFNESS, DRAG_FACTOR, (min(HELIX_DIAMETERS), max(HELIX_DIAMETERS))], dtype=float
).T
"""Ranges of the tubes of the shipped map."""
SHAPES: Final = {"ranges": (2, len(CONTEXT)), "scaling": (2, len(CONTEXT) + 3)}
"""Shapes of the additional arrays in the map of a plant."""
PROFILED: Final = {"displacement": "radial_rms_m", "snr": "noise_rms_m"}
"""Vibration measures that a map can predict, and their columns of a profile [m]."""
STORED: Final = Path(__file__).parents[1] / "data" / "vibration-map.npz"


def feeds(config: TaskConfig) -> tuple[float, float]:
    """Range of feed speeds [m/s] to search: ``FEEDS`` scaled by the fastest feed, as far as the instrument permits."""
    (slow, fast), permitted = config.feed_speeds, config.permitted_feed
    return max(slow, min(FEEDS[0] * fast / FEEDS[1], permitted)), permitted


Layers = tuple[tuple[FloatArray, FloatArray], ...]
"""Weights (inputs, outputs) and biases (outputs,) of the layers of a network, tanh between them."""


def distribution_of(
    layers: Layers, inputs: FloatArray, lowest: float, product: Callable[..., FloatArray] = np.matmul
) -> tuple[FloatArray, FloatArray]:
    """Means and standard deviations (..., t) by a network of t normal quantities, for inputs (..., d).

    ``lowest`` is the least logarithm of a standard deviation; the largest is 1.
    """
    values = inputs
    for weights, biases in layers[:-1]:
        values = np.tanh(product(values, weights) + biases)
    weights, biases = layers[-1]
    values, count = product(values, weights) + biases, len(biases) // 2
    return values[..., :count], np.exp(np.clip(values[..., count:], lowest, 1.0))


@dataclass(frozen=True, eq=False)
class VibrationMap:
    """Radial rms of a metre [m] as a log-normal distribution: mean and deviation of its decadic logarithm."""

    layers: Layers  # three
    scene: Scene = TaskConfig().scene  # bore, length, probe and air of the insertions
    ranges: FloatArray = field(default_factory=lambda: SHIPPED_RANGES)  # (2, 4) low and high of each of ``CONTEXT``
    scaling: FloatArray | None = None  # (2, 7) centre and spread of the inputs; None: see ``features_of``
    digest: str = ""  # hash of its file
    measure: str = "displacement"  # radial rms, or "snr": the noise in the band of a flaw as radial rms

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, VibrationMap) and self.digest == other.digest != "")

    def __hash__(self) -> int:
        return hash(self.digest) if self.digest else id(self)

    def predict(
        self,
        length: FloatArray,
        feed: FloatArray,
        air: FloatArray,
        context: FloatArray,
        scene: Scene,
        product: Callable[..., FloatArray] = np.matmul,
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (n,) of log10(radial rms / 0.1 mm) of a metre.

        Args:
            length: (n,) inserted length [m].
            feed: (n,) feed speed [m/s].
            air: (n,) air supply [m3/s].
            context: (n, 4) in the order of ``CONTEXT``, SI units.
            scene: scene of the prediction; for another bore or air the air supply of equal drag is used.
            product: matrix product; the default rounds a row differently in batches of other sizes.
        """
        inputs = features_of(length, feed, equivalent_air(air, feed, scene, self.scene), context)
        if self.scaling is not None:
            inputs = (inputs - self.scaling[0]) / self.scaling[1]
        return self.distribution(inputs, product)

    def distribution(
        self, features: FloatArray, product: Callable[..., FloatArray] = np.matmul
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (n,) of log10(radial rms / 0.1 mm) at ``features`` (n, 7)."""
        mean, deviation = distribution_of(self.layers, features, -5.0, product)
        return mean[:, 0], deviation[:, 0]

    @classmethod
    def load(cls, path: Path = STORED) -> VibrationMap:
        """Read a stored map (plain arrays only, no pickles)."""
        kinds = dict.fromkeys(("scene", "measure"), "U") | dict.fromkeys(SHAPES, "f")
        kinds |= {f"{part}{k}": "f" for part in ("weights", "biases") for k in range(3)}
        arrays = read_arrays(path, lambda name: kinds.get(name, ""))
        sizes = [len(CONTEXT) + 3]
        for k in range(3):
            weights, biases = (arrays.get(f"{part}{k}", np.zeros(())) for part in ("weights", "biases"))
            sizes.append(weights.shape[-1] if weights.ndim == 2 and k < 2 else 2)
            if weights.shape != (sizes[-2], sizes[-1]) or biases.shape != (sizes[-1],):
                raise FileError(path, f"layer {k}: not a map of vibration: its arrays are missing or of other shapes")
        layers = tuple((arrays[f"weights{k}"], arrays[f"biases{k}"]) for k in range(3))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        if "scene" not in arrays:  # table 2's tubes
            return cls(layers, digest=digest)
        for name, shape in SHAPES.items():
            if name not in arrays or arrays[name].shape != shape:
                raise FileError(path, f"{name}: not a map of vibration: missing, or of another shape than {shape}")
        with errors_in(path, "scene"):
            scene = Scene.model_validate_json(str(arrays["scene"]))
        measure = str(arrays.get("measure", "displacement"))
        if measure not in PROFILED:
            raise FileError(path, f"measure = {measure!r} is not one of {', '.join(PROFILED)}")
        return cls(layers, scene, arrays["ranges"], arrays["scaling"], digest, measure)

    def to_bytes(self) -> bytes:
        """The content of its file, as ``load`` reads it."""
        buffer = io.BytesIO()
        arrays = {f"weights{k}": w for k, (w, _) in enumerate(self.layers)}
        arrays |= {f"biases{k}": b for k, (_, b) in enumerate(self.layers)}
        if self.scaling is not None:
            arrays |= {"ranges": self.ranges, "scaling": self.scaling, "scene": np.array(self.scene.model_dump_json())}
        if self.measure != "displacement":
            arrays |= {"measure": np.array(self.measure)}
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        return buffer.getvalue()


def equivalent_air(air: FloatArray, feed: FloatArray, scene: Scene, reference: Scene) -> FloatArray:
    """Air supply (n,) [m3/s] with the same drag per metre in the ``reference`` scene as ``air`` has in ``scene``.

    Drag is proportional to the square of the air speed relative to the probe, (10), which moves at ``feed`` (n,) [m/s].
    It is that at the exit: expanding air loses more pressure per metre in a smaller free cross-section.
    """
    if all(getattr(scene, name) == getattr(reference, name) for name in ("air", "probe")) and (
        scene.tube.inner_diameter == reference.tube.inner_diameter
    ):
        return air
    wind = air * air_speed(scene, 1.0) - feed
    factor = np.sqrt(drag_per_metre(scene) / drag_per_metre(reference))
    return np.asarray((feed + wind * factor) / air_speed(reference, 1.0))


@lru_cache
def stored_map() -> VibrationMap:
    """The shipped map."""
    return VibrationMap.load()


def features_of(length: FloatArray, feed: FloatArray, air: FloatArray, context: FloatArray) -> FloatArray:
    """(n, 7) inputs of the map, each about -2 to 2; arguments as in ``VibrationMap.predict``."""
    return np.column_stack(
        [
            length / 30.0 - 1.0,
            np.log(feed / 0.12),
            (air * 3600.0 - 80.0) / 30.0,
            (context[:, 0] - 0.175) / 0.04,
            (context[:, 1] - 1.05e5) / 2e4,
            (context[:, 2] - 1.0) / 0.06,
            (1.0 / context[:, 3] - 0.65) / 0.2,
        ]
    )


def expected_cost(
    mean: FloatArray, deviation: FloatArray, feed: FloatArray, air: FloatArray, config: TaskConfig
) -> FloatArray:
    """Expected cost (n,) of a metre, without progress: vibration, time and air, by the task's weights.

    ``mean`` and ``deviation`` (n,) are those of ``VibrationMap.predict``; feed in m/s, air in m3/s.
    """
    limit = rms_limit(config)
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    logarithms = mean[:, None] + deviation[:, None] * nodes
    squares = capped_square(config, 10.0**logarithms * 1e-4 / limit) @ (weights / weights.sum())
    return metre_cost(config, squares, feed, air)


def rms_limit(config: TaskConfig) -> float:
    """Vibration limit of the task as a radial rms [m], the output of a map."""
    if config.vibration_measure not in PROFILED:
        raise ValueError(f"vibration_measure = {config.vibration_measure!r}: maps are of {' and '.join(PROFILED)} only")
    as_rms = config.sensor.equivalent_rms(np.array(config.limit))
    return float(as_rms) if config.vibration_measure == "snr" else config.limit


def check_measure(vibration: VibrationMap, config: TaskConfig) -> None:
    """Raise ValueError if a map predicts another vibration measure than the task's."""
    if config.vibration_measure in PROFILED and vibration.measure != config.vibration_measure:
        raise ValueError(
            f"vibration_measure = {config.vibration_measure!r}, but the map is of {vibration.measure}: make one of"
            " these tubes with `probe-env study vibration-map --tube`"
        )


def load_for(path: Path, plant: str, scene: Scene) -> VibrationMap:
    """Load a map that was made for the tubes and probe of a scene; ``plant`` is its name in error messages.

    Raises:
        FileNotFoundError: no such file.
        FileError: the map is damaged, or made for another bore, length, probe or air, or with other assumptions.
    """
    vibration, remedy = VibrationMap.load(path), "make it again with `probe-env study vibration-map`"
    for name in ("inner_diameter", "helix_length"):
        before, now = getattr(vibration.scene.tube, name), getattr(scene.tube, name)
        if before != now:
            raise FileError(path, f"{name} = {before!r} m, and {plant} has {now!r} m: {remedy}")
    for name in ("assumptions", "probe", "air"):
        if getattr(vibration.scene, name) != getattr(scene, name):
            raise FileError(path, f"{name} of the map and of {plant} differ: {remedy}")
    return vibration
