"""Commands that simulate both passes say what time-lapse does there, before any work."""

import warnings

import pandas as pd
import pytest

from agents.cli import main

TRAINING = """
[environment]
env_id = "probe_env/Inspection-v0"
fidelity = "{trained}"
[validation]
fidelity = "{validated}"
"""
SAID = "time_lapse = 4: the turn shakes the probe over so many"


@pytest.mark.parametrize(
    ("trained", "validated", "said"),
    [("fast", "standard", 1), ("standard", "fast", 1), ("fast", "fast", 1), ("standard", "standard", 0)],
)
def test_training_warns_once(trained, validated, said, tmp_path, monkeypatch):
    monkeypatch.setattr("agents.learning.train.train_all", lambda *given: pd.DataFrame())
    monkeypatch.setattr("agents.learning.train.print_curves", lambda curves: None)
    file = tmp_path / "mine.toml"
    file.write_text(TRAINING.format(trained=trained, validated=validated))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert main(["train", str(file), "--output", str(tmp_path / "out")]) == 0
    assert sum(SAID in str(one.message) for one in caught) == said


def test_the_study_of_both_passes_warns(tmp_path, monkeypatch):
    monkeypatch.setattr("agents.evaluation.passes.run_study", lambda *given: None)
    with pytest.warns(UserWarning, match=SAID):
        assert main(["passes", "--fidelity", "fast", "--output", str(tmp_path)]) == 0
