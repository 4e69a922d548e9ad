"""Other probes beside the converged mesh: what is drawn, how it is compared, and what is stored."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles.scatter import CHANCE
from scipy.stats import norm

from agents.chart import other_probes as others
from agents.chart.other_probes import FIDELITIES, INSERTED, KEYS, RANDOM, SHOWN
from agents.records.store import stored_rows
from probe_env.scene import Scene

STORED = Path(__file__).parents[2] / "results" / "chart" / "other-probes.csv"


def table(ratio: float, radial: float = 1e-4) -> pd.DataFrame:
    """Every probe, ten equal members a fidelity, of which `standard` has a ratio to the converged mesh."""
    rows = []
    for probe in others.other_probes():
        for name, fidelity in FIDELITIES.items():
            key = dict(
                zip(KEYS, (probe.name, fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch), strict=False)
            )
            values = dict.fromkeys(SHOWN, radial * (ratio if name == "standard" else 1.0))
            rows += [key | values | {"member": member, "diverged": False} for member in range(10)]
    return pd.DataFrame(rows)


def test_probes_are_those_of_their_seed_and_as_deep():
    scenes = [probe.scene for probe in others.other_probes()]
    assert len({scene.model_dump_json() for scene in scenes}) == 1 + RANDOM
    assert scenes[0].probe.guide_length == 10.0
    assert scenes[0].tube == Scene().tube
    for scene in scenes:
        inserted = scene.carrier_length + scene.probe.guide_length
        assert abs(inserted - INSERTED) <= 0.5 * scene.probe.float_pitch + 1e-9


def test_a_ratio_is_that_of_the_means():
    compared = others.ratios(table(1.25, radial=1.0), "standard")
    assert set(compared) == {probe.name for probe in others.other_probes()}
    for values in compared.values():
        assert [interval.mean for interval in values.values()] == pytest.approx([1.25] * len(SHOWN))


def test_what_is_too_small_to_matter_is_compared_with_what_matters():
    compared = others.ratios(table(2.0, radial=1e-6), "standard")["improved"]["radial_rms_m"]
    assert compared.mean == pytest.approx(1.0 + 1e-6 / 1e-5)  # a micrometre more, of ten that would matter


def test_runs_go_on_where_they_stopped(tmp_path, monkeypatch):
    calls = []

    def run(scene: Scene, fidelity, members: int) -> list[dict]:
        calls.append(fidelity.method)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return [{"member": k, "diverged": False, **dict.fromkeys(SHOWN, 1.0)} for k in range(members)]

    monkeypatch.setattr(others, "run_probe", run)
    with pytest.raises(KeyboardInterrupt):
        others.run_other_probes(tmp_path, limit=1)
    assert len(others.run_other_probes(tmp_path, limit=1)) == sum(others.MEMBERS.values())
    assert len(calls) == len(FIDELITIES) + 1


def mean_ratio(rows: pd.DataFrame, fidelity: str) -> tuple[float, float]:
    """Logarithm of the geometric mean of the probes' ratios, and how it scatters by their intervals."""
    intervals = [values["radial_rms_m"] for values in others.ratios(rows, fidelity).values()]
    scatter = np.log([interval.high / interval.low for interval in intervals]) / (2.0 * norm.isf(0.025))
    mean = np.log([interval.mean for interval in intervals]).mean()
    return float(mean), float(np.sqrt((scatter**2).sum()) / len(intervals))


def test_stored_probes_ring_as_on_the_converged_mesh():
    """The mean over the probes: a truth within the issue's tenth is so of any members but for chance.

    Version 0's mesh rings less: 0.91 and 1.07, each +- 0.02, so that other members turn them round by 4 of the standard
    deviations of the difference between two such pairs.
    """
    rows = stored_rows(STORED)
    assert set(rows["probe"]) == {probe.name for probe in others.other_probes()}
    (usual, scatter), (before, _) = (mean_ratio(rows, name) for name in ("standard", "standard-v0"))
    assert abs(usual) < np.log(1.1) + norm.isf(0.5 * CHANCE) * scatter
    assert before < usual
