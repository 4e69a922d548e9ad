"""What one change of the feed does on the way back: the table, and that it grows with friction and length."""

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.evaluation import feed_changes
from agents.evaluation.feed_changes import FRICTIONS, HEADER, LENGTHS, RAMPS, cells, run_changes


def test_a_table_has_a_row_a_scene_and_a_column_a_ramp():
    keys = list(product(FRICTIONS, LENGTHS, RAMPS, range(2)))
    rows = [(f, length, member, ramp, 1e-3 * f * length * ramp * (1 + member)) for f, length, ramp, member in keys]
    table = pd.DataFrame(rows, columns=["friction", "carrier_length", "member", "ramp", "radial_rms_m"])
    shown = cells(table)
    assert [row[:2] for row in shown] == [(f"{f:g}", f"{length:g}") for f, length in product(FRICTIONS, LENGTHS)]
    assert {len(row) for row in shown} == {len(HEADER)}
    assert [float(cell) for cell in shown[-1][2:]] == pytest.approx([1.5 * 0.25 * 50 * r for r in RAMPS], rel=0.05)


def test_the_shaking_grows_with_friction_and_length(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Quiet at 30 m and little friction, across the tube at 50 m and much: four orders of magnitude in the table."""
    for name, value in {"FRICTIONS": (0.1, 0.25), "RAMPS": (0.5,), "MEMBERS": 1, "HEADER": HEADER[:3]}.items():
        monkeypatch.setattr(feed_changes, name, value)
    table = run_changes(tmp_path)
    rms = table.set_index(["friction", "carrier_length"])["radial_rms_m"]
    assert rms[0.1, 30.0] < 1e-5
    assert rms[0.25, 50.0] > 3e-4
    stored = pd.read_csv(tmp_path / "changes.csv")
    assert np.allclose(stored["radial_rms_m"], table["radial_rms_m"], rtol=1e-4)
