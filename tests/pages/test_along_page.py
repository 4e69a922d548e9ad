"""The page of the signal says where along the tube S/N differs between fidelities."""

import shutil

import pandas as pd
import pytest

from agents.pages.signal import along

BLOCKS = {"fast": along.hearing_along, "fast-steady": along.steady_along}


@pytest.mark.parametrize("fidelity", list(BLOCKS))
@pytest.mark.parametrize("change", ["none", "of_one_sign"])
def test_stretches_that_differ_are_named(tmp_path, monkeypatch, change, fidelity):
    """With the coarse metres in place of the finer ones nothing differs; with more noise in a stretch that one does."""
    stages = {"fast": next(iter(along.TRIALS)), "fast-steady": "steady-fresh"}
    coarse = along.RESULTS / stages[fidelity] / "profile.parquet"
    (tmp_path / stages[fidelity]).mkdir()
    shutil.copy(coarse, tmp_path / stages[fidelity])
    for name in along.TRIALS:
        folder = tmp_path / name / "finer-acting"
        folder.mkdir(parents=True, exist_ok=True)
        table = pd.read_parquet(coarse)
        if change == "of_one_sign":
            stretch = (table["policy"] == "best-schedule") & table["inserted_length"].between(20.0, 25.0)
            table.loc[stretch, "noise_rms_m"] *= 1.25
        table.to_parquet(folder / "profile.parquet")
    monkeypatch.setattr(along, "RESULTS", tmp_path)
    monkeypatch.setattr("agents.rollouts.bootstrap.FLIPS", 9_999)  # tells p from 0.05 / 88, in a tenth of the time
    text = BLOCKS[fidelity]()
    assert f"S/N at `{fidelity}`" in text
    if change == "none":
        assert "none differs by more than chance" in text
    else:
        named = "; ".join(f"S/N of `best-schedule` at `{finer}` from 20 m on" for finer in along.TRIALS.values())
        assert f"these differ by more than chance: {named}.**" in text
        assert "with `best-schedule` at `standard` from 20 m on, by -20 %" in text  # 1 / 1.25
