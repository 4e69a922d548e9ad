"""Schedules: reading, writing, and errors with the location in the file."""

from pathlib import Path

import numpy as np
import pytest

from probe_env.schedule import Schedule

FOLDER = Path(__file__).parents[2] / "configs" / "schedules"
HEAD = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n"


@pytest.fixture
def read(tmp_path):
    def written(text, suffix=".csv"):
        path = tmp_path / f"schedule{suffix}"
        path.write_text(text)
        return Schedule.read(path)

    return written


@pytest.mark.parametrize("path", sorted(FOLDER.iterdir()), ids=lambda path: path.name)
def test_shipped_schedules_are_valid_and_equal_after_writing(path, read):
    schedule = Schedule.read(path)
    reread = read(schedule.to_csv())
    for name in ("over", "interpolation", "position"):
        assert getattr(reread, name) == getattr(schedule, name)
    for name in ("feed_speed", "air_supply_rate"):
        assert getattr(reread, name) == pytest.approx(getattr(schedule, name), rel=1e-5)


def test_linear_and_steps(read):
    points = HEAD + "10,0.4,72\n20,0.2,36\n"
    feed, air = read(points).at([0.0, 10.0, 15.0, 20.0, 99.0])
    assert feed == pytest.approx([0.4, 0.4, 0.3, 0.2, 0.2])
    assert air == pytest.approx([0.02, 0.02, 0.015, 0.01, 0.01])
    feed, _ = read("# interpolation: steps\n" + points).at(np.array([0.0, 10.0, 19.9, 20.0, 99.0]))
    assert feed == pytest.approx([0.4, 0.4, 0.4, 0.2, 0.2])


def test_a_measured_log_with_other_columns_is_replayed(read):
    head = "\ufefftime_s,temperature_c, feed_speed_m_per_s ,air_supply_m3_per_h\n"
    schedule = read(head + "0,20,0.2,63\n\n1.5,21,0.1,63\n")
    assert schedule.over == "time"
    assert schedule.at(0.75)[0] == pytest.approx(0.15)


def test_a_log_with_time_and_length_is_a_schedule_over_time(read):
    head = "time_s," + HEAD
    schedule = read("# interpolation: steps\n" + head + "0,5,0.2,63\n10,7,0,63\n30,7,0.1,63\n40,8,0.1,63\n")
    assert (schedule.over, schedule.position) == ("time", (0.0, 10.0, 30.0, 40.0))
    assert schedule.at([9.9, 10.0, 29.9, 30.0])[0] == pytest.approx([0.2, 0.0, 0.0, 0.1])
    assert read(head + "0,5,0.2,63\n10,4,0,63\n").over == "time"  # the lengths are not checked


def test_commas_behind_the_last_value_and_empty_rows_are_skipped(read):
    assert read(HEAD.replace("\n", ",\n") + "5,0.4,63,\n25,0.15,100,,,\n,,\n,,,\n").feed_speed == (0.4, 0.15)


BROKEN = {
    "empty": ("", "empty: a header"),
    "no rows": (HEAD, "no rows"),
    "no position": ("feed_speed_m_per_s,air_supply_m3_per_h\n0.2,63\n", "one of the columns time_s"),
    "no feed": ("time_s,air_supply_m3_per_h\n0,63\n", "column feed_speed_m_per_s is missing"),
    "column twice": ("time_s,time_s,feed_speed_m_per_s,air_supply_m3_per_h\n0,0,1,63\n", "'time_s' appears 2 times"),
    "decimal commas": (HEAD + "5,0,0,4,63\n", "5 values for 3 columns - semicolons or decimal commas"),
    "short row": (HEAD + "5,0.2\n", "line 2 has 2 values for 3 columns"),
    "text": (HEAD + "5,fast,63\n", "line 2, feed_speed_m_per_s = 'fast' is not a number"),
    "hole": (HEAD + "5,,63\n", "line 2, feed_speed_m_per_s = '' is not a number"),
    "nan": (HEAD + "5,nan,63\n", "line 2, feed_speed_m_per_s = 'nan' is not finite"),
    "negative feed": (HEAD + "5,-0.1,63\n", "line 2, feed_speed_m_per_s = -0.1 is outside the accepted range"),
    "air in m3/s by a thousand": (HEAD + "5,0.2,63000\n", "air_supply_m3_per_h = 63000.0 is outside"),
    "not ascending": (HEAD + "5,0.2,63\n4,0.2,63\n", "line 3, inserted_length_m = 4.0 must be greater than 5.0"),
    "time twice": (
        f"time_s,{HEAD}0,5,0.2,63\n0,7,0,63\n",
        "line 3, time_s = 0.0 must be greater than 0.0 before it",
    ),
    "decimal comma": (HEAD + '5,"0,2",63\n', "line 2, feed_speed_m_per_s = '0,2' is not a number"),
    "bad quote": (HEAD + '5,"0.2"x,63\n', "not CSV"),
    "unknown interpolation": ("# interpolation: cubic\n" + HEAD + "5,0.2,63\n", "interpolation = 'cubic'"),
    "other comment": ("# by hand\n" + HEAD + "5,0.2,63\n", "line 1: a comment must be"),
}
BROKEN_TOML = {
    "not toml": ("points = [", "not a TOML file"),
    "no points": ("interpolation = 'linear'", "points must be a list of tables"),
    "unknown key": ("pionts = []", "unknown key 'pionts'"),
    "missing value": (
        "points=[{time_s=0,feed_speed_m_per_s=0.2,air_supply_m3_per_h=63},{time_s=1,feed_speed_m_per_s=0.2}]",
        "point 2, air_supply_m3_per_h = None is not a number",
    ),
}


def test_broken_files_are_named(tmp_path, read):
    cases = [(".csv", *case) for case in BROKEN.values()] + [(".toml", *case) for case in BROKEN_TOML.values()]
    for suffix, text, message in cases:
        with pytest.raises(ValueError, match=message) as error:
            read(text, suffix)
        assert str(tmp_path / f"schedule{suffix}") in str(error.value)
    path = tmp_path / "binary.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not a text file in UTF-8"):
        Schedule.read(path)
    with pytest.raises(ValueError, match=r"must be a \.csv or a \.toml"):
        Schedule.read(tmp_path / "s.xlsx")
    with pytest.raises(FileNotFoundError):
        Schedule.read(tmp_path / "nowhere.csv")
