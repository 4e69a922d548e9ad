"""probe-env calibrate: from a rig's log to calibration.json and a plant that uses it; what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from agents.cli import main
from agents.plant.calibration import recorded_of
from probe_env import Plant

KEYS = ("friction", "contact_stiffness", "drag_coefficient", "damping_time")


@pytest.mark.processor
def test_the_shipped_log_is_calibrated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It was simulated with a friction of 0.2: the interval has it, and the tension alone comes within 0.02."""
    assert main(["calibrate", "example-rig", "--output", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "calibration.json").read_text())
    for name in KEYS:
        assert record[name]["low"] < record[name]["mean"] < record[name]["high"]
        assert len(record["draws"][name]) == len(record["draws"]["friction"])
    assert record["friction"]["low"] <= 0.2 <= record["friction"]["high"]
    (tube,) = record["tubes"].values()
    assert tube["by_tension_alone"]["friction"]["mean"] == pytest.approx(0.2, abs=0.02)
    assert not record["misspecified"], record["reasons"]
    assert {p.name for p in tmp_path.iterdir()} == {"calibration.json", "corner.png", "bands.png"}
    assert "verdict" in capsys.readouterr().out
    (tmp_path / "tube.toml").write_text('posterior = "calibration.json"\n')
    plant = Plant.from_toml(tmp_path / "tube.toml")
    assert plant.scene.contact.friction == pytest.approx(record["friction"]["mean"], abs=0.01)


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"paths": []}, "logs: give one log at least"),
        ({"helix_diameters": [1.0, 1.2, 1.4]}, "--helix-diameters: 3 for 2 logs"),
        ({"helix_diameters": [0.1]}, "helix_diameter = 0.1 m is outside the accepted range 0.3 to 10000 m"),
        ({"tubes": ["a"]}, "--tubes: 1 names for 2 logs"),
        ({"tubes": ["a", "a"], "helix_diameters": [1.0, 1.2]}, "'a' has helix diameters of 1 and 1.2 m"),
        ({"plant": Plant(tube={"helix_diameter": (1.0, 1.2, 1.4)})}, "tube.helix_diameter: 3 for 2 logs"),
        (
            {"plant": Plant(tube={"helix_diameter": (1.0, 1.2)}), "helix_diameters": [9.0]},
            "--helix-diameters: 9 m is none of the plant's: 1, 1.2 m",
        ),
    ],
)
def test_what_does_not_fit_is_refused_before_a_log_is_read(given: dict[str, object], problem: str) -> None:
    """In one line; the files need not even be there."""
    usual = {
        "paths": [Path("a.csv"), Path("b.csv")], "plant": Plant(), "helix_diameters": [], "tubes": [], "columns": []
    }  # fmt: skip
    with pytest.raises(ValueError, match=problem):
        recorded_of(**(usual | given))  # type: ignore[arg-type]
