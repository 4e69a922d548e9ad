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


@pytest.mark.parametrize("change", ["none", "of_one_sign"])
def test_what_differs_at_fast_steady_is_named(tmp_path, monkeypatch, change):
    (tmp_path / "hearing" / "finer-acting").mkdir(parents=True)
    shutil.copytree(hearing.RESULTS / "steady", tmp_path / "steady")
    table = pd.read_csv(tmp_path / "steady" / "episodes.csv")
    if change == "of_one_sign":
        table.loc[table["policy"] == "best-schedule", "noise_peak_to_peak_v"] *= 1.01
        table.loc[table["policy"] == "adaptive", "a90_percent_wall"] *= 0.9
    table.to_csv(tmp_path / "hearing" / "finer-acting" / "episodes.csv", index=False)
    monkeypatch.setattr(hearing, "RESULTS", tmp_path)
    text = hearing.hearing_steady()
    if change == "none":
        assert "Of 6, none differs by more than chance; too few tubes change to tell:" in text
        assert "Clear of zero: none." in text
    else:
        assert "Of 6, differ: noise peak to peak of `best-schedule` at `standard`;" in text
        assert "Clear of zero: a90 of `adaptive`, noise peak to peak of `best-schedule`." in text


def test_the_stages_compared_played_the_same_tubes():
    for one, others in (("steady", ["hearing"]), ("steady-fresh", list(hearing.TRIALS))):
        tubes = [
            pd.read_csv(hearing.RESULTS / name / "episodes.csv").drop_duplicates("context").set_index("context")
            for name in (one, *others)
        ]
        for other in tubes[1:]:
            columns = ["friction", "helix_diameter", "contact_stiffness", "drag_factor"]
            pd.testing.assert_frame_equal(tubes[0][columns], other[columns])
