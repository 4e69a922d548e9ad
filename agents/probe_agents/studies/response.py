"""Fits the calibration response to insertions with random feed and air in random tubes, with cross-validation."""

import io
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import qmc

from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.plant.inference import MIN_METRES
from probe_agents.plant.logs import Log
from probe_agents.plant.prior import FRICTION, STIFFNESS
from probe_agents.plant.response import CHANNELS, INPUTS, MIN_SPREAD, Metres, Response, inputs_of, metres_of, observed
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import origin, write_json
from probe_agents.studies.vibration_map import fit_network
from probe_agents.terminal.tables import print_line, print_terms
from probe_agents.terminal.work import Work, announce
from probe_env import Context, Fidelity, Plant, Scene
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.plants import Tubes
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import ACCELEROMETER_FLOOR, RF_FLOOR, geometric_at, value_at
from probe_env.envs.vibration_map import Layers, distribution_of
from probe_env.errors import StabilityWarning
from probe_env.fidelity import PRESETS
from probe_env.files import read_arrays

SIZE: Final = 32
"""Insertions per group, with one bore."""
BORES: Final = (22.0e-3, 26.5e-3)
"""Range of the bore [m]: clearance of 3 to 7.5 mm for table 2's floats."""
LENGTHS: Final = (60.0, 45.0, 80.0)
"""Helix lengths of the groups [m]."""
DIAMETERS: Final = (0.8, 3.0)
"""Range of the helix diameter [m]."""
DRAG_FACTORS: Final = (0.7, 1.4)
"""Range of the drag factor; also covers other air and float pitches."""
DAMPING: Final = (3e-5, 1.2e-4)
"""Range of the damping time [s]; a diverged insertion is used up to its divergence."""
FEEDS: Final = (0.045, 0.4)  # [m/s]
AIRS: Final = (30.0 / 3600.0, 130.0 / 3600.0)  # [m3/s]
SEGMENT: Final = 6.0
"""Length [m] of a linear transition of feed and air between random values; a step would excite vibration."""
SEED: Final = 20
FIDELITY: Final = "standard"
RECORDED: Final = {
    "root_tension": ("tension_mean_n", 0.0),
    "radial_acceleration_rms": ("radial_acceleration_rms_m_per_s2", ACCELEROMETER_FLOOR),
    "axial_acceleration_rms": ("axial_acceleration_rms_m_per_s2", ACCELEROMETER_FLOOR),
    "rf_noise_rms": ("radial_rms_m", RF_FLOOR),
}
"""Channel of a log -> statistic of a window, and noise of the sensor (added in squares)."""
EPOCHS, BATCH = 150, 1024
FOLDS: Final = 4
REACH: Final = (20.0, 1.5)
"""Correlation lengths of residuals [m]: of an insertion's level, and of a segment."""
LAGS: Final = 30  # [m]
RARE: Final = 0.99
"""Quantile of the misfit of held-out insertions with true parameters that is accepted."""
Program = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Feed speeds [m/s] and air supplies [m3/s] of N insertions at inserted lengths [m], (N,) each."""
Bank = Mapping[str, FloatArray]
_ALL: Final = list(range(len(CHANNELS)))


def run(output: Path, limit: int = 15, workers: Workers = HERE) -> Response:
    """Simulate ``limit`` groups of 32 insertions (resumable) and fit; writes response.npz and response.json."""
    import_module("torch")  # fails before hours of simulation

    parts = list(make_bank(limit, output, simulated, FIDELITY))
    bank = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    response, quality = fit_response(bank)
    target = output / "response.npz"
    response.save(target)
    setting = {"insertions": len(np.unique(bank["specimen"])), "metres": len(bank["length"]), "fidelity": FIDELITY}
    write_json(target.with_suffix(".json"), origin() | setting | quality)
    print_terms(
        {name: value if isinstance(value, str) else f"{value:.4g}" for name, value in (setting | quality).items()}
    )
    print_line(f"written: {target}")
    return response


class Specimen(NamedTuple):
    """Context, and damping time of the cable [s]."""

    context: Context
    damping_time: float


def tubes_of(group: int) -> tuple[Plant, list[Specimen]]:
    """Plant and specimens of a group, from a Sobol sequence over the ranges."""
    spread = qmc.Sobol(5, rng=np.random.default_rng(SEED))
    fractions = spread.fast_forward(group * SIZE).random(SIZE) if group else spread.random(SIZE)
    bore = float(value_at(qmc.Halton(1, scramble=False).fast_forward(group + 1).random(1)[0, 0], BORES))
    plant = Plant(
        tube=Tubes(inner_diameter=round(bore, 6), helix_length=LENGTHS[group % len(LENGTHS)]),
        task={"lost_drive_periods": 1000, "time_limit": 1e4},
    )

    def specimen(a: float, b: float, c: float, d: float, e: float) -> Specimen:
        tube = {"friction": value_at(np.asarray(a), FRICTION), "contact_stiffness": geometric_at(b, STIFFNESS)}
        tube |= {"drag_factor": value_at(np.asarray(c), DRAG_FACTORS), "helix_diameter": geometric_at(d, DIAMETERS)}
        return Specimen(Context(**{name: float(v) for name, v in tube.items()}), float(geometric_at(e, DAMPING)))

    return plant, [specimen(*row) for row in fractions]


def wandering(group: int) -> Program:
    """Random feed and air at every ``SEGMENT``, linear in between; slow feeds are rarer, as they take longer."""
    knots = np.arange(0.0, max(LENGTHS) + SEGMENT, SEGMENT)
    fractions = np.random.default_rng([SEED, group]).random((2, SIZE, len(knots)))

    def program(length: FloatArray) -> tuple[FloatArray, FloatArray]:
        feed, air = (
            np.array([np.interp(position, knots, row) for position, row in zip(length, fraction, strict=True)])
            for fraction in fractions
        )
        return geometric_at(feed**0.7, FEEDS), value_at(air, AIRS)

    return program


def insert(
    specimens: Sequence[Specimen], program: Program, config: TaskConfig, fidelity: Fidelity, seed: Sequence[int]
) -> list[Log]:
    """Logs of a batch of insertions, to the end of the helix, the time limit or divergence.

    Their only sensor noise is that of ``RECORDED``.
    """
    count = len(specimens)
    episodes = Episodes(count, config, fidelity=fidelity)
    options = {k: {"context": s.context, "probe": {"damping_time": s.damping_time}} for k, s in enumerate(specimens)}
    rngs = {k: np.random.default_rng([*seed, k]) for k in range(count)}
    _, infos = episodes.reset(range(count), rngs, options)
    length, time = np.array([infos[k]["inserted_length"] for k in range(count)]), np.zeros(count)
    rows: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
    while episodes.running.any():
        active = episodes.running.copy()
        episodes.step(config.actions(*program(length)), active)
        window = episodes.window
        assert window is not None
        after = np.minimum(window.inserted_length, config.scene.tube.helix_length)
        measured = [np.hypot(window.statistics[name], floor) for name, floor in RECORDED.values()]
        measured[0] = window.statistics["tension_mean_n"]  # which may push
        for k in np.flatnonzero(active & ~window.diverged).tolist():
            fed = (after[k] - length[k]) / config.period
            rows[k].append((time[k], length[k], fed, window.air_supply_rate[k], *(column[k] for column in measured)))
        length, time = np.where(active, after, length), time + config.period * active
    tables = (np.array(log, dtype=float).reshape(-1, 4 + len(RECORDED)) for log in rows)
    return [
        Log(t[:, 0], t[:, 1], t[:, 2], t[:, 3], MappingProxyType(dict(zip(RECORDED, t[:, 4:].T, strict=True))))
        for t in tables
    ]


def simulated(group: int) -> dict[str, FloatArray]:
    """Columns of the metres of a group: specimen, tube, feed, air and ``CHANNELS``."""
    plant, specimens = tubes_of(group)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # the limit is not known for low damping
        logs = insert(specimens, wandering(group), plant.configured(), PRESETS[FIDELITY], [SEED, group])
    metres = [metres_of(log) for log in logs]
    row = np.repeat(np.arange(len(metres)), [len(part) for part in metres])
    tubes = {name: np.array([getattr(s.context, name) for s in specimens])[row] for name in Context.model_fields}
    return {
        "specimen": group * SIZE + row.astype(float),
        "inner_diameter": np.full(len(row), plant.tube.inner_diameter),
        **tubes,
        "damping_time": np.array([s.damping_time for s in specimens])[row],
        **{name: np.concatenate([getattr(part, name) for part in metres]) for name in ("length", "feed", "air")},
        **{name: np.concatenate([part.measured[name] for part in metres]) for name in CHANNELS},
    }


def make_bank(
    groups: int, output: Path, simulate: Callable[[int], dict[str, FloatArray]], fidelity: str
) -> Iterator[dict[str, FloatArray]]:
    """The groups; those that are not stored in ``output`` are simulated."""
    files = [output / f"{fidelity}-{group:03d}.npz" for group in range(groups)]
    announce(Work("group", groups, lambda: sum(file.exists() for file in files), output))
    output.mkdir(parents=True, exist_ok=True)
    for group, file in enumerate(files):
        if not file.exists():
            buffer = io.BytesIO()
            np.savez_compressed(buffer, **simulate(group))  # type: ignore[arg-type]
            write_atomically(file, buffer.getvalue())
        yield read_arrays(file, lambda _: "f")


def learning_rows(bank: Bank) -> tuple[FloatArray, FloatArray]:
    """Network inputs (rows, 10) and targets (rows, c) of the metres of a bank."""
    inputs, targets = np.empty((len(bank["length"]), INPUTS)), np.empty((len(bank["length"]), len(CHANNELS)))
    for specimen in np.unique(bank["specimen"]):
        rows = np.flatnonzero(bank["specimen"] == specimen)
        length, feed, air = (bank[name][rows] for name in ("length", "feed", "air"))
        metres = Metres(length, feed, air, {name: bank[name][rows] for name in CHANNELS})
        tube = {n: float(bank[n][rows[0]]) for n in ("inner_diameter", "helix_diameter")}
        scene = Scene.fitted({"tube": tube | {"helix_length": 1e3}}).whole()
        drag = scene.air.drag_coefficient * bank["drag_factor"][rows[0]]
        table = np.array(
            [[*(bank[n][rows[0]] for n in ("friction", "contact_stiffness")), drag, bank["damping_time"][rows[0]]]]
        )
        features, tension = inputs_of(table, metres, scene)
        inputs[rows], targets[rows] = features[0], observed(metres, _ALL)
        targets[rows, 0] -= np.log10(tension[0])
    return inputs, targets


def fit_response(bank: Bank, seed: int = 0) -> tuple[Response, dict[str, float]]:
    """Fit the response to all insertions; the residuals are those of ``FOLDS``-fold cross-validation.

    Returns:
        the response; for each channel the rms error [decades] and the explained variance of held-out insertions.
    """
    inputs, targets = learning_rows(bank)
    scaling = np.array([inputs.mean(axis=0), inputs.std(axis=0)])
    x = (inputs - scaling[0]) / scaling[1]
    number = bank["specimen"].astype(int)
    mean, spread = np.empty_like(targets), np.empty_like(targets)
    for fold in range(FOLDS):
        held_out = number % FOLDS == fold
        layers = _network(x[~held_out], targets[~held_out], seed)
        mean[held_out], spread[held_out] = distribution_of(layers, x[held_out], MIN_SPREAD)
    residuals = (targets - mean) / spread
    covariances = _covariances(np.clip(residuals, -4.0, 4.0), number, bank["length"])
    layers = _network(x, targets, seed)
    quality = {}
    for k, name in enumerate(CHANNELS):
        error = targets[:, k] - mean[:, k]
        quality[f"{name}_rms_decades"] = float(np.sqrt((error**2).mean()))
        quality[f"{name}_explained"] = float(1.0 - (error**2).mean() / targets[:, k].var())
    clearance = bank["inner_diameter"] - Scene().probe.carrier_float_diameter
    covered = bank["length"], bank["feed"], np.exp(inputs[:, 4]), bank["helix_diameter"], clearance
    ranges = np.array([[v.min() for v in covered], [v.max() for v in covered]])
    response = Response(layers, scaling, ranges, covariances, np.array(REACH), np.zeros(len(CHANNELS) + 1))
    misfits = [
        response.misfit_of(residuals[rows], bank["length"][rows], _ALL)
        for rows in (np.flatnonzero(number == specimen) for specimen in np.unique(number))
        if len(rows) >= MIN_METRES
    ]
    return replace(response, misfit=np.quantile(misfits, RARE, axis=0)), quality


def _network(x: FloatArray, y: FloatArray, seed: int) -> Layers:
    """Layers for targets in their own units."""
    centre, width = y.mean(axis=0), y.std(axis=0)
    layers = [
        (w.astype(float), b.astype(float))
        for w, b in fit_network(x, (y - centre) / width, seed, EPOCHS, BATCH, (-6.0, 2.0))
    ]
    weights, biases = layers[-1]
    scale = np.concatenate([width, np.ones(len(width))])
    layers[-1] = weights * scale, biases * scale + np.concatenate([centre, np.log(width)])
    return tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in layers)


def _covariances(residuals: FloatArray, number: FloatArray, length: FloatArray) -> FloatArray:
    """(3, c, c) covariances of the ``REACH`` kernels and white noise, fitted to residuals up to ``LAGS`` apart."""
    size = residuals.shape[1]
    sums, counts = np.zeros((LAGS + 1, size, size)), np.zeros(LAGS + 1)
    for specimen in np.unique(number):
        rows = np.flatnonzero(number == specimen)
        metre = np.floor(length[rows]).astype(int)
        grid = np.full((metre.max() + 1, size), np.nan)
        grid[metre] = residuals[rows]
        for lag in range(min(LAGS + 1, len(grid))):
            a, b = grid[: len(grid) - lag], grid[lag:]
            both = ~np.isnan(a[:, 0]) & ~np.isnan(b[:, 0])
            sums[lag] += a[both].T @ b[both]
            counts[lag] += both.sum()
    covariance = sums / counts[:, None, None]
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    lags = np.arange(LAGS + 1.0)
    kernels = np.column_stack([*(np.exp(-lags / reach) for reach in REACH), lags == 0.0])
    weights = np.sqrt(counts)[:, None]
    solution = np.linalg.lstsq(kernels * weights, covariance.reshape(LAGS + 1, -1) * weights, rcond=None)[0]
    parts = solution.reshape(3, size, size)
    values, vectors = np.linalg.eigh(parts)
    return np.asarray((vectors * np.maximum(values, 1e-6)[:, None, :]) @ vectors.transpose(0, 2, 1))
