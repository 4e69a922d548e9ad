"""The probe-env command as a user meets it: outputs, overrides, resumption and errors."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.cli import main
from probe_env import Scene

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "configs" / "scenes" / "fig11_l10.toml")


def test_simulate_writes_everything(tmp_path, capsys):
    output = tmp_path / "run"
    options = ["--duration", "0.6", "--statistics-from", "0.2", "--output", str(output)]
    assert main(["simulate", SCENE, *options, "--scene.contact.friction", "0.2"]) == 0
    printed = capsys.readouterr()
    assert "radial rms" in printed.out
    assert "root tension" in printed.out
    assert "known to hold up to 0.0003 s" in printed.out
    scene = Scene.from_toml(output / "scene.toml")
    assert (scene.contact.friction, scene.carrier_length) == (0.2, 10.0)  # override and file both count
    results = json.loads((output / "results.json").read_text())
    assert results["statistics"]["radial_rms_m"] > 0.0
    assert {"commit", "packages", "machine", "command", "scene", "time_step_s"} <= set(results)
    with np.load(output / "signals.npz", allow_pickle=False) as signals:
        assert signals["time"].shape == (601,)
        assert signals["radial"].shape == (601, 3)
        assert list(signals["points"]) == ["sensor", "tip", "root"]
        assert signals["shapes_radial"].shape == (10, 501)
        assert signals["radial"][202:, 0].std() == pytest.approx(results["statistics"]["radial_rms_m"])
    for picture in ("time_histories", "locus", "spectra", "shapes", "tension"):
        assert (output / f"{picture}.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simulate", "nowhere.toml"], "no such file: nowhere.toml"),
        (["simulate", str(ROOT / "configs" / "schedules" / "example.csv")], "is not a scene file, which is TOML"),
        (["simulate", SCENE, "--duration", "1", "--statistics-from", "2"], "statistics_from = 2.0"),
        (["simulate", SCENE, "--duration", "3.00005"], "duration = 3.00005"),
        (["simulate", SCENE, "--time-step", "0.001"], "diverged at t = "),
        (["simulate", SCENE, "--nodes-per-pitch", "0"], "nodes_per_pitch = 0"),
        (["study", "--members", "0"], "members = 0"),
        (["render", "--output", "film.avi"], "'film.avi' must end in one of .gif, .mp4, .png"),
        (["render", "--every", "0"], "every = 0"),
        (["report", "nowhere"], "no such file: nowhere"),
        (["render", "--policy", "fastest"], "policy = 'fastest'"),
        (["study", "--scenes", "nowhere", "--duration", "1"], "no such file: nowhere"),
    ],
)
@pytest.mark.filterwarnings("ignore:time_step = 0.001 s is beyond the known stable limit")  # and then it diverges
def test_errors_are_one_line_and_leave_nothing_behind(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_a_bad_scene_option_names_the_field_and_the_range(capsys):
    assert main(["simulate", SCENE, "--scene.contact.friction", "1.2"]) == 2
    told = "--scene.contact.friction: 1.2 is outside the accepted range 0 to 1 (given: 1.2)"
    assert capsys.readouterr() == ("", f"probe-env: error: {told}\n")


def test_study_stores_rows_and_does_not_repeat_them(tmp_path, capsys, monkeypatch):
    from agents.study import cases as study

    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(study, "SUBSET", ("l10", "l10-wilson"))
    options = ["--subset", "--duration", "0.5", "--output", str(tmp_path)]
    assert main(["study", *options]) == 0
    first = pd.read_csv(tmp_path / "ensemble.csv")
    assert set(first["case"]) == {"l10", "l10-wilson"}
    ran = []
    original = study.run_case
    monkeypatch.setattr(study, "run_case", lambda case, *rest: (ran.append(case.name), original(case, *rest))[1])
    assert main(["study", *options, "--members", "2"]) == 0
    assert sorted(ran) == ["l10", "l10-wilson"]  # only the second members
    second = pd.read_csv(tmp_path / "ensemble.csv")
    assert len(second) == 4
    merged = second[second["member"] == 0].reset_index(drop=True)
    pd.testing.assert_frame_equal(merged[first.columns], first)


@pytest.mark.parametrize("name", ["film.gif", "film.mp4", "picture.png"])
def test_render_writes_a_film(name, tmp_path, capsys):
    output = tmp_path / name
    arguments = ["--env-id", "probe_env/Snapshot-v1", "--output", str(output), "--every", "40"]
    assert main(["render", *arguments]) == 0
    assert "share_within_limit" in capsys.readouterr().out
    assert output.stat().st_size > 20_000


def test_a_reader_that_has_enough_is_no_error():
    """Such as head: what is left to print goes nowhere, without a word."""
    done = subprocess.run(
        f"{sys.executable} -m agents.cli agents | head -1", shell=True, cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout == "ppo\n"
    assert done.stderr == ""
