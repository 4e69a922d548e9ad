"""The commands simulate, render and agents as a user meets them: outputs, overrides and errors."""

import json
import math
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs

from probe_agents.cli import main
from probe_agents.studies.vibration_map import target_of
from probe_env import Scene
from probe_env.physics.methods import METHODS

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "configs" / "scenes" / "fig11_l10.toml")
TUBE = ROOT / "configs" / "tubes" / "snr.toml"


def test_simulate_writes_everything(tmp_path, capsys):
    output = tmp_path / "run"
    options = ["--duration", "0.6", "--statistics-from", "0.2", "--output", str(output)]
    assert main(["simulate", SCENE, *options, "--scene.contact.friction", "0.2"]) == 0
    printed = capsys.readouterr().out
    assert "radial rms" in printed
    assert "stable: up to 0.0003 s" in printed
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


def test_simulate_runs_every_method_with_its_usual_step(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("probe_agents.evaluation.simulate._draw", lambda *_: None)
    for method, entry in METHODS.items():
        brief = ["--duration", "0.02", "--scene.carrier-length", "6", "--output", str(tmp_path / method)]
        assert main(["simulate", "fig11_l10", "--method", method, *brief]) == 0
        printed = capsys.readouterr().out
        assert f"{method}, time step {entry.usual_step:g} s" in printed
        assert "inf" not in printed
        results = json.loads((tmp_path / method / "results.json").read_text(), parse_constant=pytest.fail)
        assert (results["method"], results["time_step_s"]) == (method, entry.usual_step)
        assert results["statistics"]["radial_rms_m"] > 0.0
        limit = entry.stable_step(Scene.from_toml(tmp_path / method / "scene.toml"), results["nodes_per_pitch"])
        assert results["stable_time_step_s"] == (limit if math.isfinite(limit) else None)


STRIP = ["render", "--view", "strip"]


def test_escapes_in_paths_are_shown_not_sent_to_the_terminal(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("probe_agents.evaluation.simulate._draw", lambda *_: None)
    scene, output = tmp_path / "\x1b[31mred\n.toml", tmp_path / "\x1b[2J\nout"
    scene.write_text(Path(SCENE).read_text())
    brief = ["--duration", "0.02", "--scene.carrier-length", "6", "--output", str(output)]
    assert main(["simulate", str(scene), *brief]) == 0
    printed = capsys.readouterr().out
    assert printed.replace("\n", "").isprintable()
    assert printed.startswith("\\x1b[31mred\\n: ")
    assert f"written: {tmp_path}/\\x1b[2J\\nout/ (scene.toml" in printed
    assert main(["simulate", str(scene.with_name("\x1b\n.toml"))]) == 2
    assert f"no such file: {tmp_path}/\\x1b\\n.toml" in capsys.readouterr().err


def test_help_fits_any_terminal(capsys, monkeypatch):
    """In fewer than forty columns it is that of forty; tyro would take minutes."""
    helps = []
    for width in ("1", "5", "40"):
        monkeypatch.setenv("COLUMNS", width)
        with pytest.raises(SystemExit):
            main(["plc", "--help"])
        helps.append(capsys.readouterr().out)
    assert helps[0] == helps[1] == helps[2]
    assert "structured text" in " ".join(helps[0].split())


def check_film(path, pictures):
    """Number of pictures; in GIF and PNG also the size, the share of white, and that pictures differ.

    A palette of 256 colours has white a few levels lower, by processor; the lightest lines are at 217.
    """
    assert path.stat().st_size > 20_000
    if path.suffix == ".mp4":
        assert count_frames_and_secs(path)[0] == pictures
        return
    frames = iio.imread(path, index=None if path.suffix == ".png" else ...)
    frames = frames.reshape(-1, 600, 1000, frames.shape[-1])[..., :3].astype(int)
    assert len(frames) == pictures
    assert (frames > 240).all(axis=-1).mean() > 0.6
    assert all((np.abs(a - b) > 50).any() for a, b in pairwise(frames))


@pytest.mark.parametrize(
    "name", ["picture.png", *(pytest.param(f"film.{kind}", marks=pytest.mark.slow) for kind in ("gif", "mp4"))]
)
def test_render_writes_an_episode_and_slow_motion(name, tmp_path, capsys):
    """A picture every 4 s; every 5 ms of 0.05 s, each shown for 40 ms."""
    output, snapshot = tmp_path / name, ["--env-id", "probe_env/Snapshot-v1", "--output", str(tmp_path / name)]
    assert main(["render", *snapshot, "--every", "40"]) == 0
    assert "share_within_limit" in capsys.readouterr().out
    check_film(output, 1 if name == "picture.png" else 3)
    assert main([*STRIP, *snapshot, "--duration", "0.05", "--design", "improved"]) == 0
    printed = capsys.readouterr().out
    assert "times_slowed                             8\n" in printed
    assert "inserted_length_m                        60\n" in printed  # a guide of 10 m
    check_film(output, 1 if name == "picture.png" else 11)
    if output.suffix == ".gif":
        assert iio.immeta(output)["duration"] == 40
    if output.suffix == ".mp4":
        assert count_frames_and_secs(output)[1] == pytest.approx(11 / 25, abs=0.01)


def test_slow_motion_begins_at_a_length(tmp_path, capsys):
    output = tmp_path / "strip.png"
    where = ["--at", "6.5", "--length", "4", "--duration", "0.6", "--tube", "example"]
    assert main([*STRIP, "--fidelity", "fast", "--output", str(output), *where]) == 0
    figures = dict(line.split() for line in capsys.readouterr().out.splitlines() if not line.startswith("written"))
    assert 6.5 <= float(figures["inserted_length_m"]) <= 6.5 + 0.35  # at the first control period of 1 s behind it
    assert float(figures["shown_s"]) == pytest.approx(0.6)  # over three periods of 0.25 s of the dynamics
    assert {"sensor_axial_rms_m", "sensor_radial_rms_m", "sensor_axial_peak_hz"} <= set(figures)
    (tmp_path / "short.toml").write_text("[tube]\nhelix_length = 9.0\n[task]\ntime_limit = 10.0\n")
    short = ["--tube", str(tmp_path / "short.toml"), "--policy", str(tmp_path / "slow.csv")]
    (tmp_path / "slow.csv").write_text("inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.02,30\n")
    assert main([*STRIP, "--fidelity", "fast", "--at", "8.5", *short, "--output", str(tmp_path / "no.png")]) == 2
    assert "at = 8.5 m was not reached: the episode ended at " in capsys.readouterr().err.strip().splitlines()[-1]
    assert not (tmp_path / "no.png").exists()


def test_version_and_agents(capsys):
    assert (main(["--version"]), capsys.readouterr().out) == (0, f"probe-env {version('probe-env')}\n")
    assert main(["agents"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for text in ("ppo seeds 0, 1, 2, 3, 4", "tubes of train", "example"):
        assert text in printed


def test_the_map_of_a_shipped_tube_is_not_overwritten(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    (tmp_path / "mine.toml").write_text(TUBE.read_text())
    tubes = ("snr", str(TUBE), "configs/design/../tubes/snr.toml", str(tmp_path / "mine.toml"))
    targets = [target_of(Path("output"), Path(tube)) for tube in tubes]
    assert targets == [Path("output/vibration-map.npz")] * 3 + [tmp_path / "mine-map.npz"]
    assert capsys.readouterr().err.count("is shipped with its map; the new map is output/vibration-map.npz") == 3
