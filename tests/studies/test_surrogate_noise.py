"""Fit of the surrogate's noise to insertions of the surrogate itself, whose noise is known."""

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy.stats import chi2

from probe_agents.cli import main
from probe_agents.studies import surrogate_noise as study
from probe_env.envs.episodes.predicted import MEASURED, Noise, features
from probe_env.envs.vibration_map import CONTEXT

ERRORS = 4.5
"""Accepted deviation in standard errors; chance exceeds it for one of 18 values with a probability of 1.2e-4."""


def parameters(noise):
    """Arguments of ``cost``."""
    field, time = noise.field, -1.0 / np.log(noise.slow.correlation)
    return noise.bias, field.deviation, field.feed, field.air, field.length, noise.slow.deviation, time, noise.quick


@pytest.mark.slow
def test_noise_of_the_surrogate_is_recovered(tmp_path, monkeypatch):
    """Of eight insertions. Twice the log-likelihood over that of the truth is chi-square distributed."""
    monkeypatch.setattr(study, "SIZE", 8)
    monkeypatch.setattr(study, "FIDELITY", "surrogate")
    assert main(["study", "surrogate-noise", "--limit", "1", "--output", str(tmp_path)]) == 0
    noise = TypeAdapter(Noise).validate_json((tmp_path / "surrogate-noise.json").read_bytes())
    with np.load(tmp_path / "surrogate-000.npz") as bank:
        rows = dict(bank)
    missed = study.missed_by_map(rows)
    gain = study.cost(missed, *parameters(MEASURED)) - study.cost(missed, *parameters(noise))
    assert 0.0 < 2.0 * gain < chi2.isf(1e-4, len(parameters(noise)))

    for name in ("tension", "radial_scatter", "axial_scatter"):
        found, true, count = getattr(noise, name), getattr(MEASURED, name), len(rows["time"])
        square = true.correlation**2  # of Bartlett's errors
        error = np.sqrt((1.0 + square) / (1.0 - square) / (2.0 * count))
        assert found.deviation == pytest.approx(true.deviation, rel=ERRORS * error)
        assert found.correlation == pytest.approx(true.correlation, abs=ERRORS * np.sqrt((1.0 - square) / count))

    tubes = np.column_stack([rows[name] for name in CONTEXT])
    inputs = features(np.log10(rows["rf_noise_rms"] / 1e-4), rows["feed_speed"], rows["inserted_length"], tubes)
    for name in ("radial", "axial"):
        scatter = getattr(MEASURED, f"{name}_scatter")
        # upper bound of the eigenvalues of the covariance of the residuals
        largest = scatter.deviation**2 * (1.0 + scatter.correlation) / (1.0 - scatter.correlation)
        errors = np.sqrt(largest * np.diag(np.linalg.inv(inputs.T @ inputs)))
        difference = np.subtract(getattr(noise, name), getattr(MEASURED, name))
        np.testing.assert_array_less(np.abs(difference), ERRORS * errors)
