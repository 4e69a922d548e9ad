"""The probe-env command as a user meets it: outputs, overrides, resumption and errors."""

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs

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
    assert {"scene", "time_step_s"} <= set(results)
    manifest = json.loads((output / "manifest.json").read_text())
    assert manifest["files"].keys() == {"scene.toml", "results.json", "signals.npz"}
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
        (["simulate", SCENE, "--duration", "-1"], "duration = -1.0 s is outside the accepted range 0.001 to 100000 s"),
        (["simulate", str(ROOT / "configs")], f"{ROOT / 'configs'}: a folder, not a file - scenes that ship"),
        (["evaluate", "constant", "--inspects", "back"], "inspects = 'back' needs --passes both"),
        (
            ["evaluate", "constant", "--passes", "both", "--fidelity", "reference"],
            "fidelity = 'reference' does not simulate the way back; give one of standard, unlapsed, fast, study",
        ),
        (["evaluate", "constant", "--limit", "1", "--output", str(ROOT / "README.md")], "README.md: a file, where a"),
        (["simulate", SCENE, "--time-step", "0.001"], "diverged at t = "),
        (["simulate", SCENE, "--nodes-per-pitch", "0"], "nodes_per_pitch = 0"),
        (["render", "--output", "film.avi"], "'film.avi' must end in one of .gif, .mp4, .png"),
        (["render", "--every", "0"], "every = 0"),
        (["render", "--policy", "fastest"], "policy = 'fastest'"),
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
    message = "--scene.contact.friction: 1.2 is outside the accepted range 0 to 1 (given: 1.2)"
    assert capsys.readouterr() == ("", f"probe-env: error: {message}\n")


FILMS = [("film.gif", 3), ("film.mp4", 3), ("picture.png", 1)]


@pytest.mark.parametrize(("name", "pictures"), FILMS)
def test_render_writes_a_film(name, pictures, tmp_path, capsys):
    output = tmp_path / name
    arguments = ["--env-id", "probe_env/Snapshot-v1", "--output", str(output), "--every", "40"]
    assert main(["render", *arguments]) == 0
    assert "share_within_limit" in capsys.readouterr().out
    assert output.stat().st_size > 20_000
    check_film(output, pictures)


@pytest.mark.parametrize(("name", "pictures"), [(name, 11 if count > 1 else 1) for name, count in FILMS])
def test_render_writes_slow_motion(name, pictures, tmp_path, capsys):
    """A picture each 5 ms of 0.05 s, 40 ms each where the file says how long."""
    output = tmp_path / name
    arguments = ["--env-id", "probe_env/Snapshot-v1", "--output", str(output), "--duration", "0.05"]
    assert main(["render", "--view", "strip", *arguments]) == 0
    printed = capsys.readouterr().out
    assert "times_slowed                             8\n" in printed
    assert "inserted_length_m                        52.5\n" in printed
    check_film(output, pictures)
    if output.suffix == ".gif":
        assert iio.immeta(output)["duration"] == 40
    if output.suffix == ".mp4":
        assert count_frames_and_secs(output)[1] == pytest.approx(11 / 25, abs=0.01)


def check_film(path, pictures):
    """So many, of the size that was drawn, mostly white, and none like another; of an MP4 the number alone.

    A palette of 256 colours has white a few levels lower, by processor; the lightest lines are at 217.
    """
    if path.suffix == ".mp4":
        assert count_frames_and_secs(path)[0] == pictures
        return
    frames = iio.imread(path, index=None if path.suffix == ".png" else ...)
    frames = frames.reshape(-1, 600, 1000, frames.shape[-1])[..., :3].astype(int)
    assert len(frames) == pictures
    assert (frames > 240).all(axis=-1).mean() > 0.6
    assert all((np.abs(a - b) > 50).any() for a, b in pairwise(frames))


def test_slow_motion_begins_where_it_is_asked_to(tmp_path, capsys):
    output = tmp_path / "strip.png"
    where = ["--at", "6.5", "--length", "4", "--duration", "0.6", "--tube", "example"]
    assert main(["render", "--view", "strip", "--fidelity", "fast", "--output", str(output), *where]) == 0
    figures = dict(line.split() for line in capsys.readouterr().out.splitlines() if not line.startswith("written"))
    assert 6.5 <= float(figures["inserted_length_m"]) <= 6.5 + 0.35  # at the first control period of 1 s behind it
    assert float(figures["shown_s"]) == pytest.approx(0.6)  # over three periods of 0.25 s of the dynamics
    assert {"sensor_axial_rms_m", "sensor_radial_rms_m", "sensor_axial_peak_hz"} <= set(figures)


def test_slow_motion_that_is_not_reached_is_told(tmp_path, capsys):
    short = ["--fidelity", "fast", "--at", "59", "--policy", str(tmp_path / "slow.csv"), "--output"]
    (tmp_path / "slow.csv").write_text("inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.02,30\n")
    assert main(["render", "--view", "strip", *short, str(tmp_path / "strip.gif")]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert "at = 59 m was not reached: the episode ended at " in error
    assert not (tmp_path / "strip.gif").exists()


STRIP = ["render", "--view", "strip"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["render", "--at", "45"], "at = 45.0 m is of the strip: add --view strip"),
        ([*STRIP, "--at", "60"], "at = 60.0 m is outside the accepted range 5 m, where it starts, to less than 60 m"),
        ([*STRIP, "--at", "46", "--tube", "example"], "to less than 45 m"),
        ([*STRIP, "--at", "nan"], "at = nan m"),
        ([*STRIP, "--at", "30", "--env-id", "probe_env/Snapshot-v1"], "at = 30.0 m needs a probe that is fed in"),
        ([*STRIP, "--length", "2"], "length = 2.0 m is outside the accepted range 2.5 to 1000 m"),
        ([*STRIP, "--duration", "2.5"], "duration = 2.5 s is outside the accepted range 0.005 to 2 s"),
        ([*STRIP, "--duration", "0.1005"], "duration = 0.1005 s is not a whole number"),
        ([*STRIP, "--output", "film.avi"], "'film.avi' must end in one of .gif, .mp4, .png"),
        ([*STRIP, "--policy", "fastest"], "policy = 'fastest'"),
    ],
)
def test_what_a_strip_cannot_show_is_refused_before_anything_is_simulated(arguments, message, capsys, monkeypatch):
    monkeypatch.setattr("probe_env.envs.episodes.Episodes.reset", lambda *_: pytest.fail("simulated"))
    assert main(arguments) == 2
    (error,) = capsys.readouterr().err.strip().splitlines()
    assert error.startswith("probe-env: error: ")
    assert message in error


def test_a_reader_that_has_enough_is_no_error():
    """Such as head: what is left to print goes nowhere, without a word."""
    done = subprocess.run(
        f"{sys.executable} -m agents.cli agents | head -1", shell=True, cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout == "both-ways\n"
    assert done.stderr == ""


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_blas_has_one_thread_unless_the_environment_says_otherwise(given, threads):
    """It is said before numpy is loaded, which is when OpenBLAS reads it."""
    code = (
        "import os, sys; from agents.cli import main; assert 'numpy' not in sys.modules;"
        " sys.argv = ['probe-env', '--version']; main(); print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"} | given
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == threads
