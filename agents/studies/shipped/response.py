"""Makes the calibration response: learnt from wandering insertions, with the errors of those left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from typing import Final

import numpy as np

from agents.plant.inference import LEAST_METRES
from agents.plant.response import CHANNELS, INPUTS, Metres, Response, inputs_of, observed
from agents.records.manifest import origin, write_json
from agents.studies.builtin import Request
from agents.studies.shipped.insertions import FIDELITY, make_bank
from agents.studies.shipped.network import fit_network
from agents.terminal.tables import print_terms
from probe_env import Scene
from probe_env.arrays import FloatArray

EPOCHS, BATCH = 150, 1024
GROUPS: Final = 15
"""Of insertions, for the shipped response."""
FOLDS: Final = 4
REACH: Final = (20.0, 1.5)
"""[m] over which strays fade that metres have in common: of a whole insertion's level, and of a segment."""
LAGS: Final = 30  # [m]
RARE: Final = 0.99
"""Of the insertions that were left out, at their true figures, have no larger misfit than is held possible."""
Bank = Mapping[str, FloatArray]
Layers = tuple[tuple[FloatArray, FloatArray], ...]
_ALL: Final = list(range(len(CHANNELS)))


def learning_rows(bank: Bank) -> tuple[FloatArray, FloatArray]:
    """Inputs (rows, 10) of a bank's metres, and what the network is to tell of them (rows, c)."""
    inputs, targets = np.empty((len(bank["length"]), INPUTS)), np.empty((len(bank["length"]), len(CHANNELS)))
    for specimen in np.unique(bank["specimen"]):
        rows = np.flatnonzero(bank["specimen"] == specimen)
        length, feed, air = (bank[name][rows] for name in ("length", "feed", "air"))
        metres = Metres(length, feed, air, {name: bank[name][rows] for name in CHANNELS})
        tube = {n: float(bank[n][rows[0]]) for n in ("inner_diameter", "helix_diameter")}
        scene = Scene.fitted({"tube": tube | {"helix_length": 1e3}})
        drag = scene.air.drag_coefficient * bank["drag_factor"][rows[0]]
        table = np.array(
            [[*(bank[n][rows[0]] for n in ("friction", "contact_stiffness")), drag, bank["damping_time"][rows[0]]]]
        )
        shown, tension = inputs_of(table, metres, scene)
        inputs[rows], targets[rows] = shown[0], observed(metres, _ALL)
        targets[rows, 0] -= np.log10(tension[0])
    return inputs, targets


def fit_response(bank: Bank, seed: int = 0) -> tuple[Response, dict[str, float]]:
    """Learn from all insertions; the strays are those of insertions that were left out, a fourth at a time.

    Returns:
        the response; of each channel the root mean square of the strays in decades and
        the share of its variance that is told.
    """
    inputs, targets = learning_rows(bank)
    scaling = np.array([inputs.mean(axis=0), inputs.std(axis=0)])
    x = (inputs - scaling[0]) / scaling[1]
    number = bank["specimen"].astype(int)
    mean, spread = np.empty_like(targets), np.empty_like(targets)
    for fold in range(FOLDS):
        out = number % FOLDS == fold
        layers = _network(x[~out], targets[~out], seed)
        mean[out], spread[out] = _forward(layers, x[out])
    strays = (targets - mean) / spread
    alike = _alike(np.clip(strays, -4.0, 4.0), number, bank["length"])
    layers = _network(x, targets, seed)
    quality = {}
    for k, name in enumerate(CHANNELS):
        error = targets[:, k] - mean[:, k]
        quality[f"{name}_rms_decades"] = float(np.sqrt((error**2).mean()))
        quality[f"{name}_explained"] = float(1.0 - (error**2).mean() / targets[:, k].var())
    clearance = bank["inner_diameter"] - Scene().probe.carrier_float_diameter
    covered = bank["length"], bank["feed"], np.exp(inputs[:, 4]), bank["helix_diameter"], clearance
    ranges = np.array([[v.min() for v in covered], [v.max() for v in covered]])
    plain = Response(layers, scaling, ranges, alike, np.array(REACH), np.zeros(len(CHANNELS) + 1))
    misfits = [
        plain.misfit_of(strays[rows], bank["length"][rows], _ALL)
        for rows in (np.flatnonzero(number == specimen) for specimen in np.unique(number))
        if len(rows) >= LEAST_METRES
    ]
    return replace(plain, misfit=np.quantile(misfits, RARE, axis=0)), quality


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


def _forward(layers: Layers, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    values = x
    for weights, biases in layers[:-1]:
        values = np.tanh(values @ weights + biases)
    weights, biases = layers[-1]
    values = values @ weights + biases
    half = values.shape[1] // 2
    return values[:, :half], np.exp(np.clip(values[:, half:], -6.0, 1.0))


def _alike(strays: FloatArray, number: FloatArray, length: FloatArray) -> FloatArray:
    """(3, c, c) covariances whose mixture over ``REACH`` comes nearest to that of metres up to ``LAGS`` apart."""
    size = strays.shape[1]
    sums, counts = np.zeros((LAGS + 1, size, size)), np.zeros(LAGS + 1)
    for specimen in np.unique(number):
        rows = np.flatnonzero(number == specimen)
        metre = np.floor(length[rows]).astype(int)
        grid = np.full((metre.max() + 1, size), np.nan)
        grid[metre] = strays[rows]
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


def run(request: Request) -> Response:
    """Simulate the insertions (resumable), learn from them; writes response.npz and how it was made beside it.

    ``limit`` is the number of groups, of 32 insertions each in one bore.

    Raises:
        ValueError: the number of groups is out of range.
    """
    import_module("torch")  # for the network, which comes after hours of simulation

    request.without("trials", "tube")
    parts = list(make_bank(request.budget("limit", GROUPS, 256), request.output))
    bank = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    response, quality = fit_response(bank)
    target = request.output / "response.npz"
    response.save(target)
    setting = {"insertions": len(np.unique(bank["specimen"])), "metres": len(bank["length"]), "fidelity": FIDELITY}
    write_json(target.with_suffix(".json"), origin() | setting | quality)
    print_terms(
        {name: value if isinstance(value, str) else f"{value:.4g}" for name, value in (setting | quality).items()}
    )
    print(f"written: {target}")
    return response
