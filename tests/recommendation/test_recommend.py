"""probe-env recommend: a schedule that evaluate takes, simulated beside one's own; what is refused writes nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from agents.cli import main
from agents.records.reading import read_csv
from probe_env.schedule import Schedule

TUBE = "[tube]\nhelix_length = 24.0\n[contact]\nfriction = { low = 0.1, high = 0.2 }\n"


def test_it_is_written_simulated_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The schedule, how it was found, and the page with one's own schedule beside it, on tubes of the plant."""
    (tmp_path / "tube.toml").write_text(TUBE)
    own = tmp_path / "own.csv"
    own.write_text("inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.3,63\n24,0.2,63\n")
    output = tmp_path / "my.csv"
    arguments = ["--tube", str(tmp_path / "tube.toml"), "--output", str(output), "--limit", "2", "--fidelity", "fast"]
    arguments += ["--policy", str(tmp_path / "law.json")]
    assert main(["recommend", str(own), *arguments]) == 0
    assert Schedule.read(output).position[-1] == 24.0
    record = json.loads((tmp_path / "my.json").read_text())
    assert record["least_root_tension_n"] >= 1.2
    assert not record["calibrated"]
    episodes = read_csv(tmp_path / "my-confirmed" / "episodes.csv")
    assert set(episodes["policy"]) == {"recommended", "recommended-law", "own", "best-schedule", "tension-scheduled"}
    assert (episodes.groupby("policy").size() == 2).all()
    page = (tmp_path / "my-confirmed" / "report.html").read_text()
    assert "own" in page
    assert "recommended" in page
    assert "expected reward" in capsys.readouterr().out


def test_it_is_written_without_a_simulation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``--no-simulated``: the schedule and how it was found, and no folder of episodes."""
    (tmp_path / "tube.toml").write_text(TUBE)
    output = tmp_path / "my.csv"
    arguments = ["--tube", str(tmp_path / "tube.toml"), "--output", str(output), "--no-simulated"]
    assert main(["recommend", *arguments]) == 0
    assert Schedule.read(output).position[-1] == 24.0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my.csv", "my.json", "tube.toml"]
    printed = capsys.readouterr().out
    assert "simulated on" not in printed
    assert "way in" not in printed
    (tmp_path / "tube.toml").write_text(TUBE + '[task]\npasses = "both"\n')
    assert main(["recommend", *arguments]) == 0
    assert "my is for the way in, and drawn back as fast as the device can" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--output", "my.txt"], "is not a CSV file"),
        (["--policy", "my.txt"], "is not a JSON file"),
        (["nowhere.csv"], "nowhere.csv"),
        (["own.csv", "--no-simulated"], "schedules: only a simulation compares with them"),
        (["--limit", "100"], "limit = 100 is outside"),
        (["--fidelity", "fine"], "fidelity = 'fine' is not one of"),
        (["--tube", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_what_is_refused_writes_nothing(
    arguments: list[str],
    problem: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In one line, before anything is searched."""
    monkeypatch.chdir(tmp_path)
    assert main(["recommend", *arguments]) != 0
    assert problem in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
