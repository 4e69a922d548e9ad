"""What holds for every log: it feeds the same after thinning, a clean file stays as it is, units convert."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from probe_agents.cli import main
from probe_agents.plant.cleaning import Bounds
from probe_agents.plant.logs import read_log
from probe_agents.policies.catalogue import make_policy
from probe_agents.records.quantities import QUANTITIES, quantity_of, si_factor, split_head
from probe_agents.records.shipped import file_or_shipped, shipped_names
from probe_env import TaskConfig
from probe_env.schedule import Schedule

QUIET = settings(max_examples=25, deadline=None, database=None, derandomize=True)
TOLERANCE = 1e-3
"""[m], the usual one."""
RIG = "Zeit [s];Weg [m];v;Luft [m3/h]\n0;5,0;200;63\n1;5,2;200;63\n2;5,4;200;63\n"


@st.composite
def insertions(draw):
    """Time [s], true length [m] and encoder [m] of an insertion with standstills, sampled unevenly."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n, spacing = draw(st.integers(120, 600)), draw(st.sampled_from([0.02, 0.1, 0.5]))
    time = np.cumsum(np.append(0.0, spacing * rng.uniform(0.5, 1.5, n - 1)))
    speeds = rng.uniform(0.02, 0.4, 1 + n // 20) * (rng.uniform(size=1 + n // 20) > 0.3)
    length = 5.0 + np.append(0.0, np.cumsum(np.diff(time) * speeds[np.arange(n - 1) // 20]))
    noise = draw(st.sampled_from([0.0, 2e-4, 2e-3]))
    return time, length, length + noise * rng.uniform(-1.0, 1.0, n)


def written(path, time, encoder, **measured):
    columns = {"time_s": time, "inserted_length_m": encoder, "air_supply_m3_per_h": np.full(len(time), 63.0)} | measured
    np.savetxt(path, np.column_stack(list(columns.values())), "%.9f", ";", header=";".join(columns), comments="")
    return path


@QUIET
@given(insertions(), st.sampled_from([0.2, 1.0, 5.0]))
@example((np.arange(9.0), np.full(9, 5.0), np.full(9, 5.0)), 1.0)
def test_thinning_keeps_the_length_fed(tmp_path_factory, insertion, every):
    time, length, encoder = insertion
    folder, bounds = tmp_path_factory.mktemp("log"), Bounds(every=every)
    rf_noise = np.random.default_rng(len(time)).uniform(1e-6, 1e-4, len(time))
    log = read_log(written(folder / "rig.csv", time, encoder, rf_noise_rms_m=rf_noise), bounds=bounds)
    fed = log.inserted_length[0] + np.append(0.0, np.cumsum(log.feed_speed[:-1] * np.diff(log.time)))
    assert fed == pytest.approx(log.inserted_length, abs=1e-9)
    noise = np.abs(encoder - length).max()
    wrong = np.abs(np.interp(time, log.time, fed) - length).max()
    assert wrong <= TOLERANCE + noise + 2e-6  # between the encoder's least and greatest, each off by its noise
    assert log.deviation <= TOLERANCE
    assert np.diff(log.time).max() <= max(every, np.diff(time).max()) + 1e-6
    (folder / "clean.csv").write_text(log.to_csv())
    reread = read_log(folder / "clean.csv", bounds=bounds)
    assert reread.to_csv() == log.to_csv()
    assert reread.repairs == replace(reread.repairs, untimed=0, duplicates=0, missing=0, backward=0)
    schedule = Schedule.read(folder / "clean.csv")
    assert (schedule.over, schedule.interpolation) == ("time", "steps")
    played = np.cumsum(schedule.at(log.time[:-1])[0] * np.diff(log.time))
    assert played == pytest.approx(log.inserted_length[1:] - log.inserted_length[0], abs=1e-5)


def test_standstills_are_exact_and_creep_is_none(tmp_path):
    time = np.arange(0.0, 60.0, 0.1)
    speed = np.where((time >= 20.0) & (time < 35.0), 0.0, 0.1)
    length = 5.0 + np.append(0.0, np.cumsum(speed[:-1] * 0.1))
    for noise in (0.0, 3e-4):
        encoder = length + noise * np.random.default_rng(1).normal(size=len(time))
        log = read_log(written(tmp_path / "rig.csv", time, encoder))
        (dwell,) = log.dwells
        # the noise hides the tolerance and itself, at both ends, at 0.1 m/s: hundredths of a second; rows: 0.1 s apart
        assert dwell.time == pytest.approx(20.0, abs=0.15)
        assert dwell.duration == pytest.approx(15.0, abs=0.3)
        assert dwell.inserted_length == pytest.approx(7.0, abs=TOLERANCE + noise)
        inside = (log.time >= dwell.time) & (log.time < dwell.time + dwell.duration)
        assert (log.feed_speed[inside] == 0.0).all()
        assert inside.sum() >= 14  # a row a second, so that what is measured keeps its resolution
    log = read_log(written(tmp_path / "rig.csv", time, 5.0 + 1e-3 * time))
    assert log.dwells == ()
    assert log.inserted_length[-1] == pytest.approx(5.0599, abs=TOLERANCE)


def test_feed_of_a_coarse_encoder(tmp_path):
    """Steps of 0.1 m every half second: differences of rows are 0 and 1 m/s, at 0.2 m/s with a stop of 20 s."""
    time = np.arange(600) / 10
    speed = np.where((time >= 20.0) & (time < 40.0), 0.0, 0.2)
    length = 5.0 + np.append(0.0, np.cumsum(speed[:-1] * 0.1))
    encoder = np.floor(length * 10.0 + 1e-6) / 10.0
    for column in ({}, {"feed_speed_m_per_s": speed}):
        log = read_log(written(tmp_path / "rig.csv", time, encoder, **column))
        (dwell,) = log.dwells
        # within a step at both ends, and a row of the clean file, 1 s
        assert dwell.duration == pytest.approx(20.0, abs=2.0)
        assert dwell.inserted_length == pytest.approx(9.0, abs=0.1)
        assert log.inserted_length == pytest.approx(np.interp(log.time, time, length), abs=0.1 + TOLERANCE)
        away = np.abs(log.time - 20.0) > 2.5, np.abs(log.time - 40.0) > 2.5
        feed = log.feed_speed[away[0] & away[1]]
        # a step more or less in ten: 10 %; with the speed column its own
        assert np.abs(feed[feed > 0.0] - 0.2).max() <= (0.021 if not column else 1e-3)
        assert "steps of 0.1 m are coarse for rows 0.1 s apart" in log.notes[0]


def test_units_convert():
    hourly, litre, foot = 1 / 3600.0, 1e-3 / 60.0, 0.3048**3 / 60.0
    expected = {
        "feed_speed": {"mm/s": 1e-3, "ft/min": 0.3048 / 60.0, "m/min": 1.0 / 60.0, "M/MIN": 1.0 / 60.0, "m s^-1": 1.0},
        "air_supply": {
            "Nm³/h": hourly, "M3/H": hourly, "NM3/H": hourly, "Sm3/h": hourly, "m^3/s": 1.0, "l/min": litre,
            "Nl/min": litre, "SLPM": litre, "lps": 1e-3, "ft3/min": foot, "SCFM": foot, "cfm": foot, "ACFM": foot,
            "CFH": foot / 60.0,
        },
        "root_tension": {"kN": 1e3, "lbf": 4.4482216152605, "LBF": 4.4482216152605, "KN": 1e3, "daN": 10.0},
        "radial_acceleration_rms": {"g": 9.80665, "mg": 9.80665e-3, "m/s² rms": 1.0},
        "rf_noise_rms": {"µm": 1e-6, "μm": 1e-6},
        "inserted_length": {"mm": 1e-3, "ft": 0.3048, "Ft": 0.3048, "Cm": 1e-2},
        "time": {"ms": 1e-3, "S": 1.0, "MIN": 60.0, "d": 86400.0, "Seconds": 1.0, "Std.": 3600.0, "sek": 1.0,
                 "Min": 60.0, "Hr": 3600.0},
    }  # fmt: skip
    for name, units in expected.items():
        assert {unit: si_factor(unit, QUANTITIES[name]) for unit in units} == pytest.approx(units, rel=1e-12)
    for unit in ("g", "kg", "V", "%", "°C", "bar", "m/s/s/s", "1", "-", "9**9**9**9", "m" * 1000, "__import__('os')"):
        with pytest.raises(ValueError, match=rf"{re.escape(unit[:40])}.* is not .*--columns 'HEAD=none'"):
            si_factor(unit, QUANTITIES["feed_speed"])


def test_heads():
    expected = {q.column: (q.name, q.unit) for q in QUANTITIES.values() if "s2" not in q.column} | {
        "Einschubgeschwindigkeit [m/min]": ("feed_speed", "m/min"),
        "FEED SPEED (mm/s)": ("feed_speed", "mm/s"),
        "Pay-out (ft)": ("inserted_length", "ft"),
        "Druckluft [l/min]": ("air_supply", "l/min"),
        "Luft-Volumenstrom": (None, ""),
        "Weg in mm": ("inserted_length", "mm"),
        "Zeitstempel": ("time", ""),
        "Radialbeschleunigung RMS [g]": ("radial_acceleration_rms", "g"),
        "root_tension_kN": ("root_tension", "kN"),
        "axial_acceleration_rms_m_per_s2": ("axial_acceleration_rms", "m/s2"),
        "feed_set": (None, ""),
        "[m]": (None, ""),
        "": (None, ""),
        "Geschwindigkeit Soll [m/s]": (None, "m/s"),
    }
    assert {head: (quantity_of(head), split_head(head)[1]) for head in expected} == expected


def test_repairs_of_a_log_are_counted(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text(
        "time [s];length [m];air [m3/h];noise [µm]\n"
        "0;5.00;60;3\n1;5.10;60;3\n1;5.12;66;4\n;5.15;60;3\n2;5.22;;3\n3;5.30;66;3\n4;5.295;66;3\n7;5.60;66;n/a\n8;5.7;66;3\n"
    )
    log = read_log(path)
    counts = {"rows": 9, "untimed": 1, "duplicates": 1, "missing": 2, "gaps": 1, "max_gap": 3.0, "backward": 1}
    assert log.repairs == replace(log.repairs, **counts)
    assert log.repairs.max_backward == pytest.approx(0.005)
    length, air = (dict(zip(log.time, values, strict=True)) for values in (log.inserted_length, log.air_supply_rate))
    assert (length[1.0], 3600.0 * air[1.0], length[2.0], 3600.0 * air[2.0]) == pytest.approx((5.11, 63.0, 5.22, 64.5))
    assert length[3.0] == pytest.approx(5.2975, abs=TOLERANCE)
    assert log.measured["rf_noise_rms"][1] == pytest.approx(np.sqrt(12.5) * 1e-6)


def test_speed_is_integrated_or_compared_with_the_encoder(tmp_path):
    path = tmp_path / "rig.csv"
    time = np.arange(0.0, 20.0, 0.1)
    rows = [f"{t:.1f},{0.1 + 0.005 * t:.6f},63.5" for t in time]
    path.write_text("\n".join(["t [s],Vorschub [m/s],Luft [m3/h]", *rows]))
    log = read_log(path, bounds=Bounds(start_length=7.0))
    assert log.inserted_length == pytest.approx(7.0 + 0.1 * log.time + 0.0025 * log.time**2, abs=TOLERANCE)
    rows = [f"{row},{5.0 + 0.2 * t:.4f}" for row, t in zip(rows, time, strict=True)]
    path.write_text("\n".join(["t [s],Vorschub [m/s],Luft [m3/h],Weg [m]", *rows]))
    log = read_log(path)
    assert log.inserted_length == pytest.approx(5.0 + 0.2 * log.time, abs=TOLERANCE)
    (note,) = log.notes
    assert re.search(r"The speed column and the encoder disagree.*the encoder is used\.$", note)


def test_channels_are_averaged_over_their_interval(tmp_path):
    time, rng = np.arange(0.0, 10.0, 0.01), np.random.default_rng(2)
    tension, noise = rng.normal(10.0, 3.0, len(time)), rng.uniform(0.0, 1e-4, len(time))
    path = written(tmp_path / "rig.csv", time, 5.0 + 0.1 * time, root_tension_n=tension, rf_noise_rms_m=noise)
    log = read_log(path)
    edges = np.append(np.searchsorted(time, log.time[:-1] - 1e-9), len(time) - 1)
    for k, (a, b) in enumerate(itertools.pairwise(edges)):
        assert log.measured["root_tension"][k] == pytest.approx(tension[a:b].mean(), rel=1e-6)
        assert log.measured["rf_noise_rms"][k] == pytest.approx(np.sqrt(np.mean(noise[a:b] ** 2)), rel=1e-4)


def test_the_shipped_log_is_shown_and_made_a_schedule(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    assert shipped_names("logs") == ("example-rig",)
    assert main(["log", "example-rig", "--plot", "plots/rig.png"]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    unwrapped = " ".join(printed.split())
    outside, files = "is outside the task's range 0.02 to 0.4 m/s", "output/example-rig-clean.csv, plots/rig.png"
    for text in ("example-rig.csv", "root tension", "rf noise rms", "lasting [s]", outside, f"written: {files}"):
        assert text in unwrapped
    assert Path("plots/rig.png").read_bytes().startswith(b"\x89PNG")
    assert main(["log", "example-rig", "--output", "-"]) == 0
    assert capsys.readouterr().out == Path("output/example-rig-clean.csv").read_text()
    log, schedule = read_log(file_or_shipped("logs", "example-rig")), Schedule.read("output/example-rig-clean.csv")
    (dwell,) = log.dwells
    assert dwell.inserted_length == pytest.approx(30.1, abs=0.1)  # where the operator stopped at 30 m, and the ramp
    assert dwell.duration == pytest.approx(20.0, abs=2.1)  # less two ramps and two rows
    assert schedule.position == pytest.approx(log.time)
    policy = make_policy("output/example-rig-clean.csv", TaskConfig())
    assert policy.schedule.at([dwell.time + 0.5 * dwell.duration])[0] == 0.0
    assert policy.allow_standstill
    assert policy.schedule.start_length == pytest.approx(log.inserted_length[0])


def test_repeated_columns_and_protected_input(refused, capsys):
    Path("rig.csv").write_text(RIG)
    assert main(["log", "rig.csv", "--columns", "v=feed_speed[mm/s]", "--columns", "Weg=inserted_length"]) == 0
    assert Schedule.read("output/rig-clean.csv").feed_speed == pytest.approx((0.2, 0.2, 0.2))
    Path("bad.csv").write_text(RIG.replace("1;5,2;200;63", "1;5,2;Bad;-1"))
    named = ["--columns", "v=feed_speed[mm/s]", "--missing", "Bad", "--missing=-1"]
    assert main(["log", "bad.csv", *named]) == 0
    assert Schedule.read("output/bad-clean.csv").air_supply_rate == pytest.approx((63 / 3600,) * 3)
    capsys.readouterr()
    Path("link.csv").hardlink_to("rig.csv")
    for output in ("rig.csv", "./rig.csv", "link.csv"):
        refused(["log", "rig.csv", "--output", output], f"'{Path(output)}' is the log itself")


def test_texts_of_files_are_escaped_in_the_terminal(refused, capsys):
    path, formula = Path("rig\x1b[31m\n.csv"), RIG.replace("v;", "=cmd|' /C calc'!A0;")
    path.write_text(formula.replace("Zeit", "Zeit\u202e"))
    refused(["log", path], "no column for time")
    path.write_text(formula)
    assert main(["log", str(path), "--output", "clean.csv"]) == 0
    assert "\x1b" not in capsys.readouterr().out
    assert "cmd" not in Path("clean.csv").read_text()


INSTRUMENT = "[tube]\nhelix_diameter = 1.2\nhelix_length = 20.0\n[instrument]\ntest_frequency = 100.0\n"
"""Permits 100 Hz / 4 x 20 mm / 2 = 0.25 m/s; the vibration limit is 0.1 mm."""


def rig_of(feeds, noise, kept=None):
    """Text of a log from 5 m on, a row each half second, with a feed [m/s] and a noise [m] in each."""
    time, length = 0.5 * np.arange(len(feeds)), 5.0 + 0.5 * np.cumsum(np.append(0.0, feeds[:-1]))
    rows = zip(time, length, noise, strict=True)
    lines = (f"{t:.1f},{x:.4f},63,{'' if n is None else n}" for t, x, n in rows if kept is None or kept(t))
    return "\n".join(["time_s,inserted_length_m,air_supply_m3_per_h,rf_noise_rms_m", *lines])


@pytest.mark.parametrize(
    ("feeds", "noise", "kept", "verdict", "expected"),
    [
        # 5 to 10 m in 20 rows of 0.5 s at 0.5 m/s, 10 to 20 m in 100 rows at 0.2 m/s
        ([0.5] * 20 + [0.2] * 101, [2e-5] * 121, None, "5.0 m above 0.25 m/s (test_frequency), by up to 0.25 m/s; at "
         "5.0 to 10.0 m", [(5.0, 10.0, "speed")]),
        ([0.2] * 151, [2e-5] * 100 + [2e-4] * 51, None, "allowed", [(15.0, 20.0, "noise")]),
        ([0.2] * 151, [2e-5] * 151, None, "allowed", []),
        # no rows for 4 s from 8 to 8.8 m on; no noise in rows 50 to 57, from 10 to 10.8 m on
        ([0.2] * 151, [2e-5] * 151, lambda t: not 15.0 < t < 19.0, "allowed", [(7.5, 9.5, "samples")]),
        ([0.2] * 151, [2e-5] * 50 + [None] * 8 + [2e-5] * 93, None, "allowed", [(9.5, 11.5, "samples")]),
        ([0.2] * 101, [2e-5] * 101, None, "allowed", [(15.0, 20.0, "samples")]),  # ends at 15 m
    ],
)  # fmt: skip
def test_a_log_is_judged_and_its_metres_to_repeat_are_a_schedule(
    tmp_path, capsys, feeds, noise, kept, verdict, expected
):
    log, tube, clean = (tmp_path / name for name in ("rig.csv", "tube.toml", "clean.csv"))
    log.write_text(rig_of(feeds, noise, kept))
    tube.write_text(INSTRUMENT)
    assert main(["log", str(log), "--tube", str(tube), "--output", str(clean)]) == 0
    assert verdict in " ".join(capsys.readouterr().out.split())
    listed = pd.read_csv(tmp_path / "rig-to-repeat.csv")
    assert list(listed["reason"]) == [reason for *_, reason in expected]
    for row, interval in zip(listed.itertuples(index=False), expected, strict=True):
        assert (row.from_m, row.to_m) == pytest.approx(interval[:2], abs=2e-3)
    schedule = tmp_path / "repeat-rig.csv"
    assert schedule.exists() == bool(expected)
    for begin, end, _ in expected:
        assert Schedule.read(schedule).at(np.arange(begin, end - 0.1, 0.1))[0].max() <= 0.25
