"""``probe-env log``: what it prints fits the terminal, what it writes is a schedule, the log itself stays as it is."""

import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from agents.cli import main
from agents.plant.logs import read_log
from agents.records.shipped import file_or_shipped, shipped_names
from probe_env.schedule import Schedule

FILE = file_or_shipped("logs", "example-rig")
RIG = "Zeit [s];Weg [m];v;Luft [m3/h]\n0;5,0;200;63\n1;5,2;200;63\n2;5,4;200;63\n"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")


def refused(capsys, *arguments):
    """The one line of a command that is refused, and writes nothing."""
    before = sorted(Path().rglob("*"))
    assert main(["log", *map(str, arguments)]) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert printed.err.strip().isprintable()
    assert sorted(Path().rglob("*")) == before
    return printed.err


def test_the_log_that_ships_is_shown_and_made_a_schedule(capsys):
    assert shipped_names("logs") == ("example-rig",)
    assert FILE.stat().st_size < 100_000
    assert main(["log", "example-rig", "--plot", "plots/rig.png"]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    unwrapped = " ".join(printed.split())
    expected = [
        "example-rig.csv", "root tension", "rf noise rms", "lasting [s]", "leaves the task's range of 0.02 to 0.4 m/s",
        "written: output/example-rig-clean.csv, plots/rig.png",
    ]  # fmt: skip
    for text in expected:
        assert text in unwrapped
    assert Path("plots/rig.png").read_bytes().startswith(b"\x89PNG")

    log, schedule = read_log(FILE), Schedule.read("output/example-rig-clean.csv")
    (dwell,) = log.dwells
    assert dwell.inserted_length == pytest.approx(30.1, abs=0.1)  # where make_example stops, and its feed's ramp
    assert dwell.duration == pytest.approx(20.0, abs=2.1)  # less two ramps and two rows
    assert schedule.at(dwell.time + 0.5 * dwell.duration)[0] == 0.0
    assert schedule.position == pytest.approx(log.time)


def test_a_clean_log_is_a_policy_that_stands_still_where_the_log_does():
    """And does not warn of it."""
    assert main(["log", "example-rig", "--output", "rig.csv"]) == 0
    from agents.policies.catalogue import make_policy
    from probe_env import TaskConfig

    policy = make_policy("rig.csv", TaskConfig())
    feed, _ = policy.schedule.at([120.0])  # in the standstill
    assert feed == 0.0
    assert policy.stands
    assert policy.schedule.start_length == pytest.approx(read_log(FILE).inserted_length[0])


def test_columns_may_be_given_several_times_and_the_input_is_never_written(capsys):
    rig = Path("rig.csv")
    rig.write_text(RIG)
    assert main(["log", "rig.csv", "--columns", "v=feed_speed[mm/s]", "--columns", "Weg=inserted_length"]) == 0
    assert Schedule.read("output/rig-clean.csv").feed_speed == pytest.approx((0.2, 0.2, 0.2))
    capsys.readouterr()
    Path("link.csv").hardlink_to(rig)
    for output in ("rig.csv", "./rig.csv", "link.csv"):
        assert "is the log itself" in refused(capsys, "rig.csv", "--output", output)
    assert rig.read_text() == RIG
    assert "is not a CSV file" in refused(capsys, "rig.csv", "--output", "rig.txt")
    assert "is not a picture" in refused(capsys, "rig.csv", "--plot", "rig.exe")


def test_what_a_file_says_does_not_reach_the_terminal_raw(capsys):
    name = "rig\x1b[31m\n.csv"
    Path(name).write_text(RIG.replace("Zeit", "Zeit\u202e").replace("v;", "=cmd|' /C calc'!A0;"))
    assert "no column is known as time" in refused(capsys, name)
    Path(name).write_text(RIG.replace("v;", "=cmd|' /C calc'!A0;"))
    assert main(["log", name, "--output", "clean.csv"]) == 0
    printed = capsys.readouterr().out
    assert "\x1b" not in printed
    assert "cmd" not in printed + Path("clean.csv").read_text()
    assert main(["log", name]) == 0
    assert "\x1b" not in capsys.readouterr().out


def test_there_is_no_such_log(capsys):
    assert "logs that ship, by name: example-rig" in refused(capsys, "nowhere.csv")
    assert "gap = 0.0 is outside the accepted range 0.001 to 3600 s" in refused(capsys, "example-rig", "--gap", "0")
    assert "air_supply_rate" in refused(capsys, "example-rig", "--air-supply", "nan")


def test_without_pint_one_line_names_the_extra(capsys, monkeypatch):
    assert find_spec("pint")
    monkeypatch.setitem(sys.modules, "pint", None)
    assert 'this command needs pint, which is not installed: pip install "probe-env[agents]"' in refused(
        capsys, "example-rig"
    )
    Path("clean.csv").write_text(
        "time_s,inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n0,5,0.2,63\n1,5.2,0.2,63\n"
    )
    assert main(["log", "clean.csv"]) == 0  # what is clean has SI units
