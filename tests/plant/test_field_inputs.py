"""Files of loggers and spreadsheets as users report them: read right, or refused with the option that helps.

``field/`` has the files. A case with several outcomes accepts each of them.
"""

import gzip
import io
import json
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import openpyxl
import pandas as pd
import pytest
import scipy.io

from probe_agents.cli import main
from probe_agents.plant import inference
from probe_agents.plant.logs import read_log
from probe_agents.policies import catalogue
from probe_agents.records.shipped import file_or_shipped

FOLDER = Path(__file__).parent / "field"
TIME, LENGTH = "time_s", "inserted_length_m"
FEED, AIR, TENSION = "feed_speed_m_per_s", "air_supply_m3_per_h", "root_tension_n"
K = np.arange(40)
PLAIN = {
    TIME: K * 1.0,
    LENGTH: np.round(5.0 + np.append(0.0, np.cumsum(0.2 + 0.02 * np.sin(K[:-1] / 3.0))), 4),
    AIR: 63.0 + 0.1 * (K % 3),
}
"""What most files were made from, in the units of a clean file: 40 rows, 39 s, from 5 m to 12.8013 m."""
STEADY = PLAIN | {AIR: np.full(40, 63.0)}
SPEED = np.round(0.2 + 0.02 * np.sin(K / 3.0), 4)
FORCE = np.round(2.3 + 0.02 * K + 0.03 * np.sin(K), 3)
GOOD = ~np.isin(K, (11, 12))
"""Rows in which the quality of the tension is good."""
TOLERANCES = {TIME: 1e-5, LENGTH: 1.1e-3, FEED: 1e-5, AIR: 1e-3, TENSION: 1e-4}
"""1e-3 m of thinning, and the digits of the clean file."""
HARMFUL = (
    "--missing='time [s]'", "--missing=min", "--backward", "sort or cut", "load cell's scale", "is the unit right?",
    "save it again", "keyerror", "traceback",
)  # fmt: skip
"""Advice that is wrong for all of these files."""


class Read(NamedTuple):
    """Values of the clean file, and texts of the output."""

    values: Mapping[str, np.ndarray]
    texts: tuple[str, ...] = ()
    tolerances: Mapping[str, float] = {}
    until: float = 0.0  # accepted time after the last one [s]


class Refused(NamedTuple):
    """Texts of the line that refuses the file."""

    texts: tuple[str, ...]


class Case(NamedTuple):
    """An input, its options and its accepted outcomes."""

    file: str  # in ``FOLDER``, or of ``MADE``
    outcomes: tuple[Read | Refused, ...]
    options: tuple[str, ...] = ()
    edits: tuple[tuple[str, str], ...] = ()
    never: tuple[str, ...] = ()


def table(head: str, row: Callable[[int], str], count: int = 40) -> bytes:
    return "\n".join([head, *map(row, range(count)), ""]).encode()


PLAIN_LOG = table("time [s],position [m],air [m3/h]", lambda k: f"{k},{PLAIN[LENGTH][k]},{PLAIN[AIR][k]:.1f}")
PLAIN_ROWS = [[float(c) if c[0].isdigit() else c for c in row.split(",")] for row in PLAIN_LOG.decode().splitlines()]
PLAN = [["length [m]", "feed [mm/s]", "air [m3/h]"], [5, 400, 63], [25, 150, 100], [60, 80, 110]]
UNCOMPUTED = [PLAN[0], PLAN[1], ["=A2+20", "=B2*0.4", 100], PLAN[3]]


def workbook(**sheets: list[list[object]]) -> bytes:
    book, buffer = openpyxl.Workbook(), io.BytesIO()
    del book["Sheet"]
    for name, page in sheets.items():
        sheet = book.create_sheet(name)
        for row in page:
            sheet.append(row)
    book.save(buffer)
    return buffer.getvalue()


def archive(parts: Mapping[str, str | bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, content in parts.items():
            file.writestr(name, content)
    return buffer.getvalue()


def open_document(page: list[list[object]]) -> bytes:
    """A sheet of OpenDocument."""

    def cell(value: object) -> str:
        kind = f'"float" office:value="{value}"' if isinstance(value, float) else '"string"'
        return f"<table:table-cell office:value-type={kind}><text:p>{value}</text:p></table:table-cell>"

    kind, urn = "application/vnd.oasis.opendocument.spreadsheet", "urn:oasis:names:tc:opendocument:xmlns"
    lines = "".join(f"<table:table-row>{''.join(map(cell, row))}</table:table-row>" for row in page)
    spaces = " ".join(f'xmlns:{name}="{urn}:{name}:1.0"' for name in ("office", "table", "text"))
    body = f'<office:spreadsheet><table:table table:name="Log">{lines}</table:table></office:spreadsheet>'
    content = f"<office:document-content {spaces}><office:body>{body}</office:body></office:document-content>"
    entry = f'<m:file-entry m:full-path="/" m:media-type="{kind}"/>'
    manifest = f'<m:manifest xmlns:m="{urn}:manifest:1.0">{entry}</m:manifest>'
    return archive({"mimetype": kind, "content.xml": content, "META-INF/manifest.xml": manifest})


def matlab() -> bytes:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"time": PLAIN[TIME], "position": PLAIN[LENGTH]})
    return buffer.getvalue()


def rig(tension: Callable[[pd.DataFrame], object]) -> bytes:
    """The shipped log with another tension and without noise."""
    log = pd.read_csv(io.StringIO(read_log(file_or_shipped("logs", "example-rig")).to_csv()), comment="#")
    log = log.drop(columns="rf_noise_rms_m").assign(**{TENSION: tension})
    return b"# interpolation: steps\n" + log.to_csv(index=False).encode()


MADE = {
    "milliseconds.csv": lambda: table(
        "Time,Position [mm],Speed [mm/s],Air [m3/h]", lambda k: f"{2 * k},{5000 + 0.4 * k:.1f},200.0,63.0", 600
    ),
    "coarse-encoder.csv": lambda: table(
        "time [s],position [m],speed [m/s],air [m3/h]", lambda k: f"{k / 10},{5 + k // 5 / 10},0.200,63.0", 600
    ),
    "stuck.csv": lambda: rig(lambda log: log[TENSION].where(log[TIME] < 77.0, 5.84)),
    "negative.csv": lambda: rig(lambda log: -log[TENSION]),
    "log.csv.gz": lambda: gzip.compress(PLAIN_LOG),
    "log.zip": lambda: archive({"log.csv": PLAIN_LOG}),
    "log.ods": lambda: open_document(PLAIN_ROWS),
    "log.parquet": lambda: pd.read_csv(io.BytesIO(PLAIN_LOG)).to_parquet(),
    "log.mat": matlab,
    "log.tdms": lambda: b"TDSm\x0e\0\0\0\x69\x12\0\0" + bytes(range(200)),
    "log.h5": lambda: b"\x89HDF\r\n\x1a\n" + bytes(range(200)),
    "cover.xlsx": lambda: workbook(Info=[["Rig 7"], ["Operator", "A. B."]], Log=PLAIN_ROWS),
    "cover-plan.xlsx": lambda: workbook(Info=[["Rig 7"], ["Operator", "A. B."]], Plan=PLAN),
    "formula.xlsx": lambda: workbook(Plan=UNCOMPUTED),
    "step.csv": lambda: (
        b"inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.4,63\n25,0.4,63\n25,0.15,100\n60,0.15,100\n"
    ),
    "from-to.csv": lambda: b"from [m],to [m],feed [mm/s],air [m3/h]\n5,25,400,63\n25,60,150,100\n",
}
"""Name -> content of inputs that are binary or follow from others."""


def named(*columns: str, more: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Options that name columns."""
    return (*(word for column in columns for word in ("--columns", column)), *more)


FAST = {
    TIME: np.array([0.0, 1.198]), LENGTH: np.array([5.0, 5.2396]), FEED: np.full(2, 0.2), AIR: np.full(2, 63.0)
}  # fmt: skip
COARSE = {TIME: K * 1.0, LENGTH: 5.0 + 0.2 * K, FEED: np.full(40, 0.2)}
BOTH_TIMES = ("time 1 [s]", "time 2 [s]")
QUALITY = PLAIN | {TENSION: np.interp(K, K[GOOD], FORCE[GOOD])}
NAMED_BELOW = Refused(("line 1", "line 2", "position"))
JAPANESE = named("時間=time", "位置=inserted_length", "流量=air_supply")
RUSSIAN = named("Время=time[s]", "Положение=inserted_length[mm]", "Воздух=air_supply[m3/h]")
SHORT = {name: column[:20] for name, column in PLAIN.items()}
LOG_CASES = {
    # a counter of milliseconds without a unit: speed times time is 1000 times the encoder's way
    "milliseconds": Case(
        "milliseconds.csv", (Refused(("239.6 m", "0.2396 m", "unit of time", "time=time[")), Read(FAST, ("ms",))),
        never=("=none",),
    ),
    "milliseconds named": Case("milliseconds.csv", (Read(FAST),), named("Time=time[ms]")),
    # steps of 0.1 m at 10 Hz: differences of the encoder are 0 or 1 m/s
    "coarse encoder": Case(
        "coarse-encoder.csv", (Read(COARSE, ("0.1 m", "allowed"), {LENGTH: 0.11, FEED: 0.05}, 20.9),),
        ("--tube", "example"), never=("not allowed", "above 0.3"),
    ),
    "coarse encoder left out": Case("coarse-encoder.csv", (Read(COARSE, until=20.9),), named("position=none")),
    "two times": Case("two-time-columns.csv", (Refused(BOTH_TIMES),)),
    "two times, one named": Case(
        "two-time-columns.csv", (Read(PLAIN, ("time 2 [s]",)), Refused(("time 2 [s]",))), named("Time 1=time")
    ),
    "quality": Case("quality-columns.csv", (Read(QUALITY, ("2 values", "tension quality")),)),
    "quality codes": Case(
        "quality-columns.csv", (Read(QUALITY, ("2 values", "tension quality")),),
        edits=((",Good", ",192"), (",Bad", ",0")),
    ),
    "stuck channel": Case("stuck.csv", (
        Read({TIME: np.array([0.0, 412.5])}, ("tension", ("77 s", "77 to", "25.2", "25.3"))),
    )),
    **{  # amounts of gas, 60 of each: noted
        unit: Case(
            "normal-cubic-metres.csv", (Read(STEADY | {AIR: np.full(40, 60.0 * factor)}, (unit.lower(), "m3/h")),),
            edits=(("Nm3/h", unit),),
        )
        for unit, factor in (("Nm3/h", 1.0), ("Sm3/h", 1.0), ("slpm", 0.06), ("SCFM", 60.0 * 0.3048**3))
    },
    "catman": Case("catman.txt", (Read(PLAIN | {TENSION: FORCE}),)),
    "catman, English": Case(
        "catman.txt", (Read(PLAIN | {TENSION: FORCE}),),
        edits=(("Zeit  1 - Standardmessrate", "Time  1 - default sample rate"),),
    ),
    "nanoseconds": Case("epoch-nanoseconds.csv", (Read(STEADY),)),
    "TwinCAT": Case("twincat-scope.txt", (Read(PLAIN), Refused(("twincat", "export", "time column")))),
    "names below": Case("names-below-and-stop-row.csv", (Read(PLAIN, ("stop trg",)), NAMED_BELOW)),
    "header again": Case("header-again.csv", (Read(PLAIN, ("line 22", "header")),)),
    **{
        f"summer time ends {place}": Case(
            "clock-back-an-hour.csv", (Read(PLAIN, ("summer time",)), Refused(("summer time",))),
            edits=(("2025-10-26 02", hour),),
        )
        for place, hour in (("here", "2025-10-26 02"), ("in England", "2025-10-26 01"), ("in America", "2025-11-02 01"))
    },
    "zones": Case("zone-names.csv", (Read(PLAIN),)),
    "zones of London": Case("zone-names.csv", (Read(PLAIN),), edits=(("CEST", "BST"), ("CET", "GMT"))),
    "zones of California": Case("zone-names.csv", (Read(PLAIN),), edits=(("CEST", "PDT"), ("CET", "PST"))),
    "zone in brackets": Case("zone-in-brackets.csv", (Read(PLAIN),)),
    "JavaScript dates": Case("javascript-dates.csv", (Read(PLAIN),)),
    "durations of a PLC": Case("iec-durations.csv", (Read(PLAIN),)),
    "dates of a PLC": Case(
        "zone-in-brackets.csv", (Read(PLAIN), Refused(("--time-format", "dt#2025"))),
        edits=(("2025-03-04T", "DT#2025-03-04-"), ("+01:00[Europe/Berlin]", "")),
    ),
    "Japanese": Case("shift-jis.csv", (Refused(("--encoding",)), Refused(("'時間 [s]'",)))),
    "Japanese named": Case("shift-jis.csv", (Read(PLAIN),), (*JAPANESE, "--encoding", "cp932")),
    "Russian": Case("cyrillic.csv", (Refused(("line 1", "--encoding")), Refused(("line 1", "'время [с]'")))),
    "Russian named": Case("cyrillic.csv", (Read(PLAIN),), (*RUSSIAN, "--encoding", "cp1251")),
    "gzip": Case("log.csv.gz", (Read(PLAIN), Refused(("compressed", "gunzip")))),
    "zip": Case("log.zip", (Read(PLAIN), Refused(("zip", "unpack")))),
    "ods": Case("log.ods", (Read(PLAIN), Refused(("opendocument", "csv")))),
    "parquet": Case("log.parquet", (Read(PLAIN), Refused(("parquet", "csv")))),
    "MATLAB": Case("log.mat", (Refused(("matlab", "csv")),)),
    "TDMS": Case("log.tdms", (Refused(("tdms", "csv")),)),
    "HDF5": Case("log.h5", (Refused(("hdf5", "csv")),)),
    "cover sheet": Case("cover.xlsx", (Read(PLAIN, ("'log'",)), Refused(("'info', 'log'", "--sheet")))),
    "cover sheet, named": Case("cover.xlsx", (Read(PLAIN),), ("--sheet", "Log")),
    "long form of InfluxDB": Case("influx-long.csv", (
        Refused(("inserted_length=inserted_length[unit]",)),
    )),
    "long form of InfluxDB with units": Case("influx-long.csv", (
        Read({name: column[:30] for name, column in PLAIN.items()}, ("long form",)),
    ), named("inserted_length=inserted_length[m]", "air_supply=air_supply[m3/h]")),
    "long form": Case("series-time-value.csv", (
        Read(PLAIN), Refused(("long form", "pivot", "'position [m]'", "'air [m3/h]'")),
    )),
    "Ignition": Case("ignition.csv", (Read(PLAIN),)),
    "in and out": Case("in-and-out.csv", (Read(STEADY, ("withdrawal",), until=4.0), Refused(("withdrawal", "--pass")))),
    "in and out, the way in": Case("in-and-out.csv", (Read(STEADY, until=4.0),), ("--pass", "in")),
    "in and out, the first pass": Case("in-and-out.csv", (Read(STEADY, until=4.0),), ("--pass", "1")),
    "pulled back": Case("pulled-back.csv", (Refused(("withdrawal",)),)),
    "counts": Case("encoder-counts.csv", (Refused(("'counts'", "encoder=inserted_length[m/")),)),
    "counts with a factor": Case("encoder-counts.csv", (Read(STEADY),), named("encoder=inserted_length[m/4096]")),
    "position reversed": Case("negative-position.csv", (Refused(("sign", "position=inserted_length[-m]")),)),
    "position turned": Case("negative-position.csv", (Read(PLAIN),), named("position=inserted_length[-m]")),
    "speed reversed": Case("negative-speed.csv", (Refused(("sign", "speed=feed_speed[-mm/s]")),)),
    "speed turned": Case("negative-speed.csv", (
        Read(PLAIN | {LENGTH: 5.0 + np.append(0.0, np.cumsum(0.5 * (SPEED[1:] + SPEED[:-1])))}),
    ), named("speed=feed_speed[-mm/s]")),
    "no time": Case("no-time-column.csv", (Refused(("--rate",)),)),
    "no time but a rate": Case("no-time-column.csv", (Read(PLAIN),), ("--rate", "1")),
    "twice the rate": Case("no-time-column.csv", (Read({TIME: 0.5 * K, LENGTH: PLAIN[LENGTH]}),), ("--rate", "2")),
    "tension turned": Case("negative.csv", (
        Read({TIME: np.array([0.0, 412.5]), TENSION: np.array([1.93, 2.69])}, tolerances={TENSION: 0.01}),
    ), named("root_tension_n=root_tension[-N]")),
    "summary rows": Case("summary-rows.csv", (Read(PLAIN, ("line 43",)),)),
    "units in cells": Case("values-with-units.csv", (
        Read(PLAIN), Refused(("'5.0 m'", "position=inserted_length[m]")),
    )),
    "lines of JSON": Case("lines-of-json.jsonl", (Read(SHORT), Refused(("json", "csv")))),
}  # fmt: skip


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch):
    """Paths are short, and lines are not wrapped."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")


def write(case: Case) -> str:
    content = MADE[case.file]() if case.file in MADE else (FOLDER / case.file).read_bytes()
    for old, new in case.edits:
        assert old.encode() in content
        content = content.replace(old.encode(), new.encode())
    Path(case.file).write_bytes(content)
    return case.file


def run(arguments: list[str], case: Case, capsys) -> tuple[int, str]:
    """Status and output of a command, which gives no harmful advice; one line that names the file if it is refused."""
    status = main(arguments)
    printed = capsys.readouterr()
    assert status in (0, 2)
    if status == 2:
        assert printed.out == "" or arguments[0] == "evaluate"
        assert printed.err.startswith("probe-env: error: ")
        assert printed.err.count("\n") == 1
        assert case.file in printed.err
    text = " ".join((printed.out + printed.err).replace(case.file, "").casefold().split())
    assert [word for word in (*HARMFUL, *case.never) if word.casefold() in text] == []
    return status, text


def lacking(texts: tuple[str | tuple[str, ...], ...], text: str) -> list[object]:
    """The texts that are missing; one of a tuple is enough."""
    return [t for t in texts if not any(part in text for part in ((t,) if isinstance(t, str) else t))]


def check_values(clean: pd.DataFrame, expected: Read) -> None:
    """Compare a clean file with the values at their times."""
    tolerances = TOLERANCES | expected.tolerances
    time = expected.values[TIME]
    assert clean[TIME].iloc[0] == 0.0
    assert -tolerances[TIME] <= clean[TIME].iloc[-1] - time[-1] <= expected.until + tolerances[TIME]
    for name, values in expected.values.items():
        assert np.interp(time, clean[TIME], clean[name]) == pytest.approx(values, abs=tolerances[name]), name


@pytest.mark.parametrize("name", LOG_CASES)
def test_logs_of_users(name, capsys):
    case, clean = LOG_CASES[name], Path("clean.csv")
    status, text = run(["log", write(case), "--output", str(clean), *case.options], case, capsys)
    accepted = [outcome for outcome in case.outcomes if isinstance(outcome, Refused) == (status == 2)]
    assert accepted, text
    assert [] in [lacking(outcome.texts, text) for outcome in accepted], text
    assert clean.exists() == (status == 0)
    if status == 0:
        (expected,) = accepted
        check_values(pd.read_csv(clean, comment="#"), expected)
        for repeat in Path().glob("*-to-repeat.csv"):
            assert "speed" not in set(pd.read_csv(repeat)["reason"])


STEPS = {10.0: (0.4, 63.0), 24.9: (0.4, 63.0), 25.1: (0.15, 100.0), 50.0: (0.15, 100.0)}
SCHEDULE_CASES = {
    # file, options, texts of the output if it is refused and if it is read
    "a step": ("step.csv", (), ("line 4", ("# interpolation: steps", "25.01")), ()),
    "from and to": ("from-to.csv", (), ("'from [m]'", "length", ("# interpolation: steps", "steps")), ()),
    "a cover sheet": ("cover-plan.xlsx", (), ("'info', 'plan'", "--sheet"), ("'plan'",)),
    "a cover sheet, named": ("cover-plan.xlsx", ("--sheet", "Plan"), None, ()),
    "formulas": ("formula.xlsx", (), ("row 3", "formula", "open the workbook in excel and save it"), None),
}
"""Texts are None where this outcome is wrong."""


@pytest.mark.parametrize("name", SCHEDULE_CASES)
def test_schedules_of_users(name, capsys, monkeypatch):
    file, options, refused, read = SCHEDULE_CASES[name]
    schedules, read_schedule = [], catalogue.read_schedule

    def recorded(*arguments, **settings):
        schedules.append(read_schedule(*arguments, **settings))
        return schedules[-1]

    monkeypatch.setattr(catalogue, "read_schedule", recorded)
    case = Case(file, ())
    command = ["evaluate", write(case), "--fidelity", "surrogate", "--limit", "1", "--output", "evaluation"]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        status, text = run([*command, *options], case, capsys)
    text += " ".join(str(warning.message).casefold() for warning in caught)
    texts = refused if status else read
    assert texts is not None, text
    assert lacking(texts, text) == []
    if status == 0:
        expected = {5.0: (0.4, 63.0), 15.0: (0.275, 81.5), 60.0: (0.08, 110.0)} if "cover" in file else STEPS
        for length, (feed, air) in expected.items():
            assert schedules[0].at([length])[0] == pytest.approx(feed)
            assert 3600.0 * schedules[0].at([length])[1] == pytest.approx(air)


@pytest.mark.parametrize(
    ("file", "texts"),
    [
        ("stuck.csv", ("tension", ("77 s", "77 to", "25.2", "25.3"))),
        ("negative.csv", ("tension", "sign", "root_tension_n=root_tension[-n]")),
    ],
)
def test_faulty_channels_are_not_calibrated(file, texts, capsys, monkeypatch):
    """They are refused, or the posterior is one that ``recommend`` refuses."""
    for steps in ("BURN_IN", "STEPS"):
        monkeypatch.setattr(inference, steps, 60)
    case = Case(file, ())
    status, text = run(["calibrate", write(case), "--output", "fit"], case, capsys)
    assert status == 2 or json.loads(Path("fit/calibration.json").read_text())["misspecified"]
    assert lacking(texts, text) == []
