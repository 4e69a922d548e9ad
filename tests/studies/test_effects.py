"""Effects of the parts of the whole model: scenes, means without diverged members, onset, closed form."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from probe_agents.studies import effects
from probe_agents.studies.effects import EFFECTS, MODELS, ONSET, PARTS, Effect
from probe_env import Scene, StabilityWarning
from probe_env.fidelity import PRESETS, Fidelity

FOLDER = Path(__file__).parents[2] / "results" / "effects"
KEYS = {"friction": 0.1, "model": "study"}


def test_the_parts_together_are_the_whole_model():
    scenes = {model: Effect(0.15, 50.0, model, 1).scene() for model in MODELS}
    assert scenes["study"] == Scene()
    assert scenes["whole"] == Scene().whole()
    for effect, changes in EFFECTS.items():
        assert scenes[f"whole with {effect}"] == Scene().whole().model_copy(update=changes) != scenes["whole"]
    ratio = -np.log(0.7) / np.hypot(np.pi, np.log(0.7))  # of a damped bounce, with the mass of a pitch
    assert EFFECTS["restitution 0.7"]["contact"]["damping"] == pytest.approx(
        2.0 * ratio * np.sqrt(1e5 * 0.0111), rel=0.01
    )
    for part, changes in PARTS.items():
        assert scenes[f"whole without {part}"].model_copy(update=changes) == scenes["whole"]
        assert len({scenes[part], scenes[f"whole without {part}"], scenes["study"], scenes["whole"]}) == 4


@pytest.mark.parametrize("model", ["study", "whole"])
def test_stored_root_tension_and_frequency_are_those_of_the_present_code(model):
    """Without vibration; four digits are stored, and the spectrum has a resolution of 0.5 Hz."""
    stored = pd.read_csv(FOLDER / "effects.csv").set_index(["friction", "carrier_length_m", "model"])
    rows = pd.DataFrame(Effect(0.1, 5.0, model, 2).rows())
    row = stored.loc[(0.1, 5.0, model)]
    assert rows["tension_mean_n"].mean() == pytest.approx(row["tension_mean_n"], rel=1e-3)
    assert rows["axial_peak_hz"].mean() == pytest.approx(row["axial_peak_hz"], abs=0.5)


def test_diverged_members_are_counted_and_not_averaged(monkeypatch):
    rows = Effect(0.15, 0.5, "study", 2).rows()
    monkeypatch.setitem(PRESETS, "standard", Fidelity(method="imex32", time_step=5e-4))  # 1.7 times the limit
    with pytest.warns(StabilityWarning):
        rows += Effect(0.15, 0.5, "study", 1).rows()
    (row,) = effects.effects(pd.DataFrame(rows)).to_dict("records")
    assert row["diverged"] == 1
    assert np.isnan(rows[2]["axial_peak_hz"])
    assert row["tension_mean_n"] == pytest.approx(np.mean([row["tension_mean_n"] for row in rows[:2]]))


def test_onset_is_interpolated_in_the_logarithm():
    """Growth by a factor of ten in 5 m reaches the onset at 13 m; a member that stays below has none."""
    rows = [
        KEYS | {"member": member, "carrier_length_m": x, "radial_rms_m": ONSET * 10.0 ** ((x - at) / 5.0)}
        for member, at in enumerate((12.0, 14.0, 99.0))
        for x in effects.LENGTHS
    ]
    (row,) = effects.onsets(pd.DataFrame(rows)).to_dict("records")
    assert row == pytest.approx(KEYS | {"onset_m": 13.0, "error_m": 1.0, "members": 2})
