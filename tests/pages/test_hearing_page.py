"""The page of the signal says so where fidelities differ."""

import shutil

import pandas as pd
import pytest

from agents.pages.signal import hearing


@pytest.mark.parametrize("change", ["none", "of_one_sign"])
def test_what_differs_between_fidelities_is_named(tmp_path, monkeypatch, change):
    """With the coarse episodes in place of the finer ones nothing differs; with a change of one sign that KPI does."""
    for name in hearing.TRIALS:
        shutil.copytree(hearing.RESULTS / name, tmp_path / name)
        table = pd.read_csv(tmp_path / name / "episodes.csv")
        if change == "of_one_sign":
            table.loc[table["policy"] == "best-schedule", "noise_peak_to_peak_v"] *= 1.01
        table.to_csv(tmp_path / name / "finer-acting" / "episodes.csv", index=False)
    monkeypatch.setattr(hearing, "RESULTS", tmp_path)
    text = hearing.hearing_fresh()
    if change == "none":
        assert "Of 12, none differs by more than chance; too few tubes change to tell:" in text
        assert text.partition("|")[0].count("` at `") == 12  # none changes
    else:
        assert "Of 12, differ:" in text
        assert "of `best-schedule` at `standard`" in text
        assert "of `best-schedule` at `reference`" in text
        assert "best-constant` at" not in text.partition("; too few")[0]
