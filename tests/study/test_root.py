"""The root's place in a pitch: its cases, rows that are not run twice, tables, and what the stored ensemble says."""

from pathlib import Path

import numpy as np
import pandas as pd

from agents.study.claims import Ensemble
from agents.study.root_tables import close, lengths, meshes, ratio
from agents.study.roots import CASES, KEPT, LENGTHS, MESHES, NEAR, SUBSET, Root, load_rows, run_root, run_roots

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "configs" / "scenes"
TABLE = load_rows(ROOT / "results" / "study")
NAMED = {case.name: case for case in CASES}


def test_cases_differ_in_their_names():
    assert len(NAMED) == len(CASES)
    assert set(SUBSET) < set(NAMED)


def test_a_member_does_not_depend_on_its_company():
    case = Root(3, 0.25)
    rows = run_root(case, SCENES, (1, 2, 3), 0.5)
    (alone,) = run_root(case, SCENES, (2,), 0.5)
    pd.testing.assert_series_equal(pd.Series(rows[1]), pd.Series(alone), check_exact=True)


def test_the_root_lies_where_it_should():
    """A pitch further is the next float's place: the same as so much more carrier from there, but for its start."""
    held, next_one = Root(3, 1.0), Root(3)
    tensions = [run_root(case, SCENES, (1,), 2.0)[0]["tension_mean_n"] for case in (held, next_one)]
    assert tensions[0] > tensions[1] > 0.0  # steady sliding pulls more, the longer the probe
    assert run_root(Root(3, grows=True), SCENES, (1,), 2.0)[0]["tension_mean_n"] > 0.0


def test_rows_are_stored_and_not_repeated(tmp_path, monkeypatch):
    ran = []

    def rows(case, scenes, members, duration, threads):
        ran.extend((case.name, member) for member in members)
        return [{"case": case.name, "member": k, "duration_s": duration} | dict.fromkeys(KEPT, 1.0) for k in members]

    monkeypatch.setattr("agents.study.roots.run_root", rows)
    assert len(run_roots(SCENES, tmp_path, 1, 4.0, SUBSET)) == len(SUBSET)
    assert len(run_roots(SCENES, tmp_path, 2, 4.0, SUBSET)) == 2 * len(SUBSET)
    assert sorted(ran) == sorted((name, member) for name in SUBSET for member in (1, 2))


def test_ratios_have_the_interval_of_their_means():
    values = np.array([0.9, 1.0, 1.1, 1.0])
    assert ratio(2.0 * values, values).startswith("2.00 [1.")
    assert ratio(values[:1], values[:1]) == "1"
    assert lengths(pd.DataFrame({"case": [], "member": []} | {name: [] for name in KEPT})) == []


def test_the_stored_ensemble_is_whole():
    assert set(TABLE["case"]) == set(NAMED)
    assert (TABLE.groupby("case").size() == 16).all()
    assert TABLE["diverged_at_s"].isna().all()
    assert (len(lengths(TABLE)), len(meshes(TABLE)), len(close(TABLE, SCENES))) == (
        len(LENGTHS), len(MESHES) + 1, len(NEAR),
    )  # fmt: skip


def test_places_between_floats_ring_more_on_every_mesh():
    e = Ensemble(TABLE)
    for length in LENGTHS:
        for place in (0.25, 0.5, 0.75):
            assert e.greater(Root(length, place).name, Root(length).name, "axial_rms_m")
            if length in (20, 30, 40):
                assert e.greater(Root(length, place).name, Root(length).name)
    for case in CASES:
        if case.time_step == 5e-5 and case.place == 0.0:
            half = Root(30, 0.5, case.method, case.time_step, case.nodes_per_pitch)
            assert e.greater(half.name, case.name)
