"""What a change of the feed does on the way back: the table, its scenes, and that it grows with the exponent."""

import math
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles.scatter import of_another

from agents.evaluation import feed_changes
from agents.evaluation.feed_changes import COLUMNS, EXPONENTS, HEADER, RAMPS, TUBES, cells, run_changes, scene_of


def test_a_table_has_a_row_an_exponent_and_a_column_a_ramp():
    rows = []
    for exponent, tube, ramp, member in product(EXPONENTS, TUBES, RAMPS, range(2)):
        rms = 1e-3 * exponent * (ramp + 0.01) * (1 + TUBES.index(tube)) * (1 + 2 * member)
        rows.append((exponent, 0.1, *tube, member, ramp, rms))
    shown = cells(pd.DataFrame(rows, columns=list(COLUMNS)))
    assert [row[0] for row in shown] == [f"{exponent:g}" for exponent in EXPONENTS]
    assert {len(row) for row in shown} == {len(HEADER)}
    for row, exponent in zip(shown, EXPONENTS, strict=True):
        for cell, ramp in zip(row[1:], RAMPS, strict=True):
            ends = [float(end) for end in cell.split(" to ")]
            assert ends == pytest.approx([exponent * (ramp + 0.01) * k for k in (2.0, 6.0)], rel=0.06)  # two digits


def test_scenes_of_an_exponent_have_it():
    for tube in TUBES:
        scene = scene_of(9.0, *tube)
        assert scene.contact.friction * scene.inserted_length / (0.5 * scene.tube.helix_diameter) == pytest.approx(9.0)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """25 m, two exponents, the task's own ramp and none, two members."""
    changed = {"EXPONENTS": (6.0, 9.0), "TUBES": TUBES[1:2], "RAMPS": (0.5, 0.0), "MEMBERS": 2}
    for name, value in (changed | {"HEADER": (HEADER[0], HEADER[1], HEADER[-1])}).items():
        monkeypatch.setattr(feed_changes, name, value)


@pytest.mark.processor
def test_what_arrives_grows_with_the_exponent(small: None, tmp_path: Path):
    """By a factor of 65 from 6 to 9, where the first floats leave the wall; without a change nothing does.

    The logarithm and its deviation from member to member are those of the four in the published table.
    """
    table = run_changes(tmp_path)
    mean = table.groupby(["exponent", "ramp"])["radial_rms_m"].mean()
    assert (mean[:, 0.0] < 1e-3 * mean[9.0, 0.5]).all()
    growth = math.log(mean[9.0, 0.5] / mean[6.0, 0.5])
    assert growth == pytest.approx(4.18, abs=of_another(0.011, measured=4, members=2))
    stored = pd.read_csv(tmp_path / "changes.csv")
    assert np.allclose(stored["radial_rms_m"], table["radial_rms_m"], rtol=1e-4)


@pytest.mark.filterwarnings("ignore:time_step = 0.001 s is beyond the known stable limit")
def test_a_diverged_probe_is_told(small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(feed_changes, "SETTLING", 0.1)
    monkeypatch.setattr(feed_changes, "BOTH_WAYS", {"fast": Coarse()})
    with pytest.raises(RuntimeError, match=r"\d of 4 simulations diverged at ramp = 0.5 m/s2"):
        run_changes(tmp_path)
    assert not list(tmp_path.iterdir())


class Coarse:
    """A step beyond every limit."""

    method, time_step, nodes_per_pitch = "imex", 1e-3, 4
