"""Files of other people's rigs are read as they meant them, or refused in one line that says where and what to do."""

import io
import os
import re
import zipfile
from datetime import datetime, time, timedelta

import pandas as pd
import pytest

from probe_agents.plant.cleaning import Bounds
from probe_agents.plant.logs import USUAL, read_log
from probe_agents.records.cells import ReadOptions
from probe_agents.records.reader import read_schedule
from probe_env.files import FileError


def read(path, columns=(), bounds=USUAL, **options):
    """A log, with the options of the command."""
    return read_log(path, ReadOptions(tuple(columns), **options), bounds)


HEAD = "time [s];length [m];feed [m/s];air [m3/h]"
ROWS = ((0, 5.0), (1, 5.2), (2, 5.4), (3, 5.6))
"""Time [s] and length [m] of all readable files, at 0.2 m/s and 63 m3/h."""
SHORT, LONG = "{t};{x};{v};{a}", "{t};{mm};200.0;63.0"


def lines(separator=";", sign=".", head=HEAD, row=SHORT, **fields):
    """The text of the log that all files here hold; ``fields`` are functions of time and length, or date formats."""
    fields = {"mm": lambda _, x: f"{1e3 * x:.1f}"} | fields
    texts = []
    for t, x in ROWS:
        moment = datetime(2024, 5, 31, 23, 59, 58) + timedelta(seconds=t)
        values = {k: moment.strftime(f) if isinstance(f, str) else f(t, x) for k, f in fields.items()}
        text = row.format(t=t, x=f"{x:.2f}", v="0.20", a="63.0", **values)
        texts.append(text.replace(".", sign).replace(";", separator))
    return "\n".join([head.replace(";", separator), *texts])


def sheet(*rows):
    """A workbook whose second sheet, "Messung", has these rows."""
    import openpyxl

    book, buffer = openpyxl.Workbook(), io.BytesIO()
    book.active.title = "Notizen"
    book.active.append(["nothing"])
    page = book.create_sheet("Messung")
    for row in rows:
        page.append(row)
    book.save(buffer)
    return buffer.getvalue()


CLOCK = "{c};{x};{v};{a}"


def clocks(*texts):
    """The log with these times."""
    return lines(row=CLOCK, c=lambda t, _: texts[t])


DATED, DAYS = "Datum;Zeit;length [m];feed [m/s];air [m3/h]", "{d};{c};{x};{v};{a}"
MS_HEAD = HEAD.replace(";", ";ms;", 1)
GERMAN = "Zeit [s];Weg [mm];Vorschub [mm/s];Luft (Nm³/h)"
GERMAN_LOG = lines(sign=",", head=GERMAN, row=LONG)
OTHER = "Kanal 1;Kanal 2;Kanal 3;Kanal 4"
NAMED = ("Kanal 1=time", "Kanal 2=inserted_length[m]", "Kanal 3=feed_speed[m/s]", "Kanal 4=air_supply[m3/h]")
MIDNIGHT = [time(23, 59, 57), time(23, 59, 58), time(23, 59, 59), time(0)]
SHEET_HEAD = ["Zeit", "Weg [m]", "Luft [m3/h]"]
FOREIGN = {
    "commas": lines(","),
    "semicolons and decimal commas": lines(sign=","),
    "tabs": lines("\t"),
    "pipes": lines("|"),
    "a table of pipes": lines(" | ").replace("\n", " |\n| ").replace("time", "| time", 1) + " |",
    "spaces": lines("   ", sign=","),
    "spaces before": "  " + lines("  ").replace("\n", "\n   "),
    "a separator at the end": lines().replace("\n", ";\n").replace("m3/h];", "m3/h]") + ";",
    "quotes and decimal commas": lines(",", ",", HEAD.replace(";", '";"').join('""'), '"{t}";"{x}";"{v}";"{a}"'),
    "a byte order mark": ("\ufeff" + lines()).encode(),
    "UTF-16": GERMAN_LOG.encode("utf-16"),
    "UTF-16 without a mark": GERMAN_LOG.encode("utf-16-be"),
    "UTF-16, little end first": GERMAN_LOG.encode("utf-16-le"),
    "Windows' Western European": GERMAN_LOG.encode("cp1252"),
    "lines of Windows and Ctrl-Z": lines().replace("\n", "\r\n") + "\r\n\x1a",
    "lines of an old Macintosh": lines().replace("\n", "\r"),
    "a preamble": "Rig 3; probe 7\nOperator;N. N.\n\n# by hand\n" + lines() + "\n\n% the end\n",
    "the head in a comment": "#" + lines(),
    "units below": lines(head="time;length;feed;air\ns;m;m/s;m³/h"),
    "units below in brackets": lines(head="time;length;feed;air\n[s];[m];[m/s];[m^3/h]"),
    "German heads": GERMAN_LOG,
    "units in names": lines(
        head="time_ms;length_mm;feed_mm_per_s;air_m3_per_h", row="{ms};{mm};200.0;63.0", ms=lambda t, _: f"{1e3 * t}"
    ),
    "any heads": (lines(head=OTHER), NAMED),
    "a head with its unit": (
        lines(head="a [s];b [m];c (m/s);d [m3/h];", row=SHORT + ";"),
        ("a=time", "b [m]=inserted_length", "c (m/s)=feed_speed", "d=air_supply"),
    ),
    "a head with =": (lines(head=HEAD.replace("feed [m/s]", "v=x/t")), ("v=x/t=feed_speed[m/s]",)),
    "feet and litres a minute": lines(
        head="time [min];length [ft];feed [ft/min];air [l/min]", row="{m};{f};39.3700787;1050.0",
        m=lambda t, _: f"{t / 60.0:.9f}", f=lambda _, x: f"{x / 0.3048:.9f}",
    ),
    **{form: lines(row=CLOCK, c=form) for form in (
        "%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S.250+02:00", "%d.%m.%Y %H:%M:%S,5", "%H:%M:%S", "%I:%M:%S %p",
        "%Y/%m/%d %H:%M:%S", "%d/%m/%y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%d.%m.%y %H:%M:%S", "%d-%b-%Y %H:%M:%S",
        "%a %b %d %H:%M:%S %Y", "%Y%m%dT%H%M%S", "%Y%m%d%H%M%S", "%Y-%m-%d %H:%M:%S CET", "%H:%M:%S:500",
    )},
    "timestamps between spaces": lines("  ", row=CLOCK, c="%Y-%m-%d %H:%M:%S"),
    "a clock with decimal commas": lines(sign=",", row=CLOCK, c="%H:%M:%S.500"),
    "a date and a clock": lines(head=DATED, row=DAYS, d="%d.%m.%Y", c="%H:%M:%S"),
    "a named date": (lines(head=DATED.replace("Datum", "D"), row=DAYS, d="%Y-%m-%d", c="%H:%M:%S"), ("D=date",)),
    "American dates": clocks(*(f"3/4/2025 {time} AM" for time in ("9:59:58", "9:59:59", "10:00:00", "10:00:01"))),
    "German names of months": lines(row=CLOCK, c=lambda t, _: f"Mo 3. März 2025, 09:59:{50 + t}"),
    "elapsed days": clocks("0 days 23:59:58", "0 days 23:59:59", "1 day, 0:00:00", "1 days 00:00:01"),
    "24:00": clocks("23:59:59", "24:00:00", "00:00:01", "00:00:02"),
    "dates with slashes and a clock": lines(head=DATED, row=DAYS, d="%Y/%m/%d", c="%H:%M:%S"),
    "American dates and a clock": lines(head=DATED, row=DAYS, d="%m/%d/%Y", c="%I:%M:%S %p"),
    "serial days and a clock": lines(head=DATED, row=DAYS, d=lambda t, _: f"{45443 + t // 2}", c="%H:%M:%S"),
    "a column of milliseconds": lines(head=MS_HEAD, row="{c};250;{x};{v};{a}", c="%Y/%m/%d %H:%M:%S"),
    "AM between spaces": lines(" ", head="Time;length[m];feed[m/s];air[m3/h]", row="{c};{x};{v};{a}", c="%I:%M:%S;%p"),
    "date and clock between spaces": lines(
        " ", head="Date;Time;length[m];feed[m/s];air[m3/h]", row=DAYS, d="%d.%m.%Y", c="%H:%M:%S"
    ),
    "a date of the start alone": lines(head=DATED, row=DAYS, d=lambda *_: "31/5/24", c="%H:%M:%S"),
    "a date beside seconds": lines(head=DATED, row=DAYS, d="%d.%m.%Y", c=lambda t, _: f"{t}"),
    "no time at first": lines(row=CLOCK, c="%H:%M:%S").replace("\n", "\nn/a;4.9;0.2;63.0\n", 1),
    "seconds from anywhere": lines(row=CLOCK, c=lambda t, _: f"{1.7e9 + t:.1f}"),
    **{f"thousands by {mark}": lines(
        head=GERMAN, row=f"{{t}};{{k}}{sign}0;200{sign}0;63{sign}0", k=lambda _, x, m=mark: f"{x:.3f}".replace(".", m)
    ) for mark, sign in ((".", ","), ("’", "."), ("\u202f", ","))},
    "exponents and signs": lines(row="+{t}E+0;{mm}e-3;2.0E-1;+6.3e1"),
    "a minus of Unicode": lines(row="{t};{mm}e\u22123;{v};{a}"),
    "signs apart": lines(row="{t};+ {x};+   {v};+ {a}"),
    "heads with line breaks": lines(",", head='Time;"Inserted\nLength\n[m]";"Feed\n[m/s]";"Air [m3/h]"'),
    "units behind a comma": lines(head="Time, s;Length, m;Feed, m/s;Air, m³/h"),
    "units behind a bare slash": lines(head="Zeit/s;Weg/mm;Vorschub/(m/s);Luft/m³/h", row="{t};{mm};{v};{a}"),
    "a logger with units and rows of numbers": lines(
        ",", head="Number;Date&Time;ms;length;feed;air\nNO.;Time;ms;mm;mm/s;m3/h", row="{t};{c};0;+ {mm};+ 200;+ {a}",
        c="%Y/%m/%d %H:%M:%S",
    ),
    "LabVIEW": lines("\t", ",", "Y_Unit_Label;m;m/s;m3/h\n***End_of_Header***;;;;\nX_Value;Length;Feed;Air;Comment"),
    "a time beside each channel": lines(
        head="X_Value;length [m];X_Value;feed [m/s];X_Value;air [m3/h]", row="{t};{x};{t};{v};{t};{a}"
    ),
    "an index without a heading": lines(",", head=HEAD.replace("time [s]", ""), row=CLOCK, c="%Y-%m-%d %H:%M:%S"),
    "TOA5": '"TOA5","rig","CR1000"\n' + lines(
        ",", head='TIMESTAMP;RECORD;Length_Avg;Feed_Avg;Air_Avg\n"TS";"RN";"m";"m/s";"m^3/h"\n"";"";"Avg";"Avg";"Avg"',
        row='"{c}";{t};{x};{v};{a}', c="%Y-%m-%d %H:%M:%S",
    ),
    "rows of separators": lines().replace("\n1", "\n;;;\n1") + "\n;;;\n",
    "units behind a space": lines(",", head="Time s;Inserted Length mm;Feed Speed mm/s;Air Flow m³/h", row=LONG),
    "units with slashes behind underscores": lines(head="time_s;length_mm;feed_mm/s;air_m³/h", row=LONG),
    "units behind a slash": lines(head="Zeit / s;Weg / mm;Vorschub / (m/s);Luft / m3/h", row="{t};{mm};{v};{a}"),
    "a form of time below": lines(head="Time;Length;Feed;Air\nhh:mm:ss;m;m/s;m³/h", row=CLOCK, c="%H:%M:%S"),
    "objects below": lines(head="time;length;feed;air\ns;m;m/s;m3/h\n;probe-a;probe-a;probe-a"),
    "a last head that no row fills": lines(head=HEAD + ";Comment"),
    "a comment in some rows": lines(head=HEAD + ";Comment").replace("63.0", "63.0;start", 1),
    "capital units": lines(head="TIME (SEC);LENGTH (MM);FEED (M/MIN);AIR FLOW (SLPM)", row="{t};{mm};12.0;1050"),
    "a LAS file": "~Version\n VERS. 2.0 : LAS\n WRAP. NO :\n~Curve\n TIME.S : time\n LENGTH.M : length\n"
    " FEED.M/MIN : feed\n AIR.M3/H :\n~A  TIME LENGTH FEED AIR\n" + lines("  ", head="", row="{t};{x};12.0;{a}")[1:],
    "other columns": lines(head=HEAD + ";p [bar];note", row=SHORT + ";1.013;ok"),
    "a table of pandas with missing numbers": pd.read_csv(
        io.StringIO(lines(head=HEAD + ";p", row=SHORT + ";")), sep=";"
    ).convert_dtypes().to_parquet(),
    "a sheet": sheet(
        ["rig 3"], ["Zeit", "Weg", "Vorschub", "Luft"], ["s", "mm", "mm/s", "m³/h"],
        *([t, 1e3 * x, 200, 63.0] for t, x in ROWS),
    ),
    "a sheet with clock and text": sheet(SHEET_HEAD, *([MIDNIGHT[t], f"{x:.2f}", 63] for t, x in ROWS)),
    "a sheet with a date and a clock": sheet(
        ["Datum", *SHEET_HEAD], *([datetime(2024, 5, 31 - (t < 3)), MIDNIGHT[t], x, 63] for t, x in ROWS)
    ),
    "a sheet with elapsed times": sheet(SHEET_HEAD, *([timedelta(seconds=86_398 + t), x, 63] for t, x in ROWS)),
    "a sheet with dates": sheet(SHEET_HEAD, *([datetime(2024, 1, 1) + timedelta(seconds=t), x, 63] for t, x in ROWS)),
}  # fmt: skip


def test_foreign_files_are_read(tmp_path):
    path, failures = tmp_path / "rig.log", {}
    for name, case in FOREIGN.items():
        content, columns = case if isinstance(case, tuple) else (case, ())
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        try:
            log = read(path, columns, sheet="Messung" if name.startswith("a sheet") else None)
            assert log.time == pytest.approx([0, 1, 2, 3], abs=1e-6)
            assert log.inserted_length == pytest.approx([5.0, 5.2, 5.4, 5.6], abs=2e-6)
            assert log.feed_speed == pytest.approx([0.2] * 4, abs=1e-5)
            assert log.air_supply_rate == pytest.approx([63.0 / 3600.0] * 4, rel=1e-6)
            expected = ("is read as", "amount of gas", "Not read: ")  # and the speed column agrees
            assert all(any(text in note for text in expected) for note in log.notes)
        except (AssertionError, ValueError) as error:
            failures[name] = error
    assert not failures


BAD = lines()
NUMBER = "line 4, column 'length [m]': {!r} is not a finite number"
CHANGED = [
    ("feed", "\x1b[31mfeed", "line 1: not a text file: a control character (0x1b)"),
    ("5.40", "5.4\0", "line 4: not a text file: a control character (0x00)"),
    ("1;5.20;0.20;63.0", "1;5.20", "line 3: 2 values for 4 columns"),
    ("1;5.20;0.20;63.0", "1;5.20;0.20;63.0;7;8", "line 3: 6 values for 4 columns"),
    *(("5.40", cell, NUMBER.format(cell)) for cell in ("fast", "off", "inf", "1e999", "=1+1", "5,40,1.5")),
    ("2;5.40;0.20;63.0", HEAD[:-1], "line 4, column 'time [s]': 'time [s]' is not a finite"),
    ("5.40", "5,40", "line 4, column 'length [m]': '5,40' is not a finite number with the decimal sign '.'"),
    ("\n2;", "\n0.5;", "line 4, column 'time [s]': the time '0.5' is 0.5 s before the row"),
    ("\n3;", "\n3e9;", "line 5, column 'time [s]': 3e+09 s are more than 100000 s"),
    ("\n3;", "\n9;", "lines 4 to 5: no rows for 7 s, more than the 5 s"),
    ("[m]", "[furlongs?]", "column 'length [furlongs?]': 'furlongs?' is not a unit"),
    ("[m]", "[wubbles]", "column 'length [wubbles]': the unit 'wubbles' is unknown"),
    ("[m]", "[kg]", "column 'length [kg]': 'kg' is not a unit of inserted_length - convert the column to m"),
    ("length [m]", "length", "column 'length' has no unit: declare it, --columns 'length=inserted_length[UNIT]'"),
    ("5.40", "off", "or leave it empty, or if it marks a missing value, --missing=off"),
    ("length [m]", "Vorschub [m/s]", "columns 'Vorschub [m/s]' and 'feed [m/s]' are both feed_speed"),
    ("time", "clock?", "no column for time; found: 'clock? [s]', 'length [m]'"),
    ("air", "p", "no column for air_supply; found: 'time [s]'"),
    ("length [m];feed", "p [m];q", "no column for feed_speed or inserted_length"),
    ("3;5.60", "3;5.10", "line 5, column 'length [m]': the probe moves back to 5.1 m from 5.4 m"),
    ("3;5.60", "3;9.60", "lines 4 to 5: the inserted length jumps from 5.4 to 9.6 m, at 4.2 m/s"),
    ("63.0", "6300.0", "line 2, column 'air [m3/h]': air_supply = 6300 m3/h is outside the accepted range 0 to "),
    ("5.20", '"5.20', "line 3: not CSV: unexpected end of data"),
]
"""What is changed in a good log -> message."""
HOLE = HEAD + "\n" + "\n".join(f"{t};{'' if 2 < t < 12 else 5.5};0.0;63.0" for t in range(20))


def with_days(day, clock):
    """The first and then the second day of a month, two rows each."""
    return lines(head=DATED, row=DAYS, d=lambda t, _: day.format(1 + t // 2), c=clock)


PAUSE = "lines 3 to 4: no rows for {} s, more than the 5 s"
AMBIGUOUS = "line 2, column 'Weg [mm]': '{}' is ambiguous: decimal sign or thousands"
BROKEN = [
    ("", "empty: a header"),
    ("\n" * 2500 + BAD, "line 1: no header with two known quantities; found: none"),
    (HEAD, "line 1: a header without rows"),
    ("time;feed;air\ns;m/s;m3/h\n", "line 1: a header without rows"),
    ("\n".join(BAD.split("\n")[:2]), "line 2, column 'time [s]': 1 rows have a time: at least two"),
    (lines(head=OTHER), "line 1: no header with two known quantities; found: 'Kanal 1', 'Kanal 2'"),
    ("Dear all,\nthis is not a log.\n", "no header with two known quantities"),
    (bytes(range(256)) * 8, "line 2: not a text file (byte 0x81)"),
    (b"\xff\xfe" + BAD.encode("utf-16-le")[:-1], "line 5: not a text file (byte 0x"),
    (BAD[:-9], "line 5: 3 values for 4 columns, separated by ';' - the file ends within it"),
    (lines(",", row="{t};5,0;0,2;63,0"), "line 2: 7 values for 4 columns, separated by ',' - decimal commas and"),
    (lines(row="{t};nan;{v};{a}"), "line 2, column 'length [m]': no value in the whole column"),
    (lines(head=GERMAN, row="{t};{x}0;200;63"), AMBIGUOUS.format("5.000")),
    (lines(",", ",", GERMAN, '{t};"{x}0";200;63'), AMBIGUOUS.format("5,000")),
    (lines(row="7;{x};{v};{a}"), "line 5, column 'time [s]': the time never changes"),
    (lines(row=CLOCK, c="2024-02-31T%H:%M:%S"), "line 2, column 'time [s]': '2024-02-31T23"),
    (lines(row=CLOCK, c=lambda t, _: f"25:00:0{t}"), "line 2, column 'time [s]': '25:00:00' is not a"),
    (lines(row=CLOCK, c=lambda t, _: f"12:00:0{t}" if t != 2 else "2"), "line 4, column 'time [s]': '2' is not a time"),
    (
        lines(row=CLOCK, c=lambda t, _: f"2024-05-31T12:00:0{t}{'Z' * (t == 2)}"),
        "line 4, column 'time [s]': '2024-05-31T12:00:02Z' is another form of time than '2024-05-31T12:00:00' above",
    ),
    (with_days("0{}.06.2024", lambda t, _: f"{9 - t // 2}:00:0{t}"), PAUSE.format(82801)),
    (with_days("0{}.06.2024", lambda t, _: f"12:00:0{t}"), PAUSE.format(86401)),
    (with_days("day {}", "%H:%M:%S"), "line 2, column 'Zeit': 'day 1' beside it is not a date like 2024-05-31"),
    (
        clocks("12:59:58", "12:59:59", "1:00:00", "1:00:01"),
        "line 4, column 'time [s]': the time '1:00:00' is 43199 s before the row above: a 12-hour clock without AM",
    ),
    (
        lines(row=CLOCK, c=lambda t, _: f"T#{t}s" if t != 2 else "2"),
        "line 4, column 'time [s]': '2' is not a time",
    ),
    (lines(row=CLOCK, c=lambda t, _: f"T#{t + 3630 * (t > 1)}s"), "lines 3 to 4: no rows for 3631 s, more than the 5"),
    (lines(row=CLOCK, c=lambda t, _: f"9h0m{t}s"), "'9h0m0s' is not a time like 2024-05-31T14:05:09.25, 31.05.2024"),
    (
        lines(head=MS_HEAD, row="{c};{mm};{x};{v};{a}", c="%H:%M:%S"),
        "line 2, column 'ms': fraction = 5 s is outside the accepted range 0 to 1 s - leave it out, --columns 'ms=",
    ),
    (HOLE, "lines 4 to 14: column 'length [m]' has no values for 10 s, more than the 5 s"),
    (
        lines(row="{t};{mm};{v};{a}"),
        "line 2, column 'length [m]': inserted_length = 5000 m is outside the accepted range 0 to 1000 m",
    ),
    ("Rig;3\nDate;5/4/2025;;;;\n" + lines(head=OTHER), "line 3: no header with two known quantities; found: 'Kanal 1'"),
    (
        BAD.partition("\n")[2],
        "line 1: no header with two known quantities; found: '0', '5.00', '0.20', '63.0' - is the",
    ),
    (lines(row="########;{x};{v};{a}"), "line 2, column 'time [s]': '########' is not a finite number"),
    (HEAD + ";x" * 300 + "\n1;2;3;4", "line 1: 304 columns are more than 256"),
    (b"\xd0\xcf\x11\xe0" + bytes(2000), "a file that cannot be read (CalamineError): save it again, or export it as"),
    (
        b"PK\x03\x04" + bytes(2000),
        "a compressed file or a workbook that is damaged (BadZipFile): copy or save it again",
    ),
    (b"\x1f\x8b" + bytes(2000), "a compressed file or a workbook that is damaged (BadGzipFile): copy or save it again"),
    (b"PK\x05\x06" + bytes(18), "not a text file"),
    (
        sheet(["a", "b"]),
        "no sheet has a header with two known quantities; there are 'Notizen', 'Messung': --sheet NAME",
    ),
]


def archive(parts):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in parts.items():
            file.writestr(name, content)
    return buffer.getvalue()


HEADS = ["time [s]", "feed [m/s]", "air [m3/h]"]
GOOD_SHEET = sheet(HEADS, [0, 0.2, 63], [1, 0.2, 63])


def with_part(old, new=None, part="xl/worksheets/sheet2.xml"):
    """The good workbook with something replaced in a part, or with another part."""
    with zipfile.ZipFile(io.BytesIO(GOOD_SHEET)) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    assert new is None or old in parts[part]
    return archive(parts | {part: old if new is None else parts[part].replace(old, new, 1)})


LAST_CELL = b'<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
"""That of a sheet of 17e9 cells."""
SHEETS = [
    (with_part(b"</sheetData>", LAST_CELL), "cannot be read within 60 s and 4 GiB of memory: save it again, or"),
    (with_part(b"<a/>" * 2_000_000, part="xl/workbook.xml"), "a file that cannot be read (CalamineError): save it"),
    (GOOD_SHEET[:-200], "a compressed file or a workbook that is damaged (BadZipFile): copy or save it again"),
    (archive({"a.txt": b"1"}), "not a workbook, so it has no sheet 'Messung': leave --sheet out"),
    (archive({"a.txt": b"1", "b.txt": b"2"}), "an archive of 2 files, a.txt, b.txt: unpack it, and name one"),
    (sheet(HEADS, [0, 0.2, 63], [1, True, 63]), "row 3, column 'feed [m/s]': 'True' is not a finite number"),
    # formulas that were not computed
    (sheet(HEADS, [0, "=1+1", 63], [1, "=1+1", 63]), "row 2, column 'feed [m/s]': no value in the whole column"),
    (sheet(HEADS, [0, 0.2, 63, 7]), "row 2: 4 values for 3 columns - correct that row"),
    (sheet([None]), "empty: a header and rows of numbers are needed; --sheet names another"),
    (sheet(HEADS, [0] * 300), "row 2: 300 values for 3 columns"),
]


def test_broken_files_are_refused_in_one_line(tmp_path):
    cases = [(content, message, None) for content, message in BROKEN]
    for old, new, message in CHANGED:
        assert old in BAD
        cases.append((BAD.replace(old, new, 1), message, None))
    cases += [(content, message, "Messung") for content, message in SHEETS]
    cases.append((GOOD_SHEET, "no sheet 'sheet\\x1b[31m'; there are 'Notizen', 'Messung'", "sheet\x1b[31m"))
    path, failures = tmp_path / "rig.log", []
    for content, message, name in cases:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        try:
            failures.append((message, read(path, sheet=name)))
        except FileError as error:
            if not str(error).startswith(str(path)) or message not in str(error) or not str(error).isprintable():
                failures.append((message, str(error)))
    assert not failures


TENSION = "time [s];length [m];air [m3/h];tension [N]\n"
SPEED = "time [s];length [m];feed [{}];air [m3/h]\n"
MUTANTS = {  # content -> whether it may be read; then there is a note
    "a decimal comma that looks like thousands": (TENSION + "0;5.0;63;2.25\n1;5.2;63;2,360\n2;5.4;63;2.47\n", False),
    "a decimal point that looks like thousands": (TENSION + "0;5,0;63;2,25\n1;5,2;63;2.360\n2;5,4;63;2,47\n", False),
    "an exponent alone": (TENSION + "0;5.0;63;2.25\n1;5.2;63;e5\n2;5.4;63;2.47\n", False),
    "a speed 1000 times the encoder's": (SPEED.format("m/s") + "0;5;0.2;63\n1;5.0002;0.2;63\n2;5.0004;0.2;63\n", False),
    "a speed 1000 times as slow": (SPEED.format("mm/s") + "0;5.0;0.2;63\n1;5.2;0.2;63\n2;5.4;0.2;63\n", False),
    "rows above the header": (TENSION.replace("m]", "") + "0;5.0;63;2\n" + TENSION + "1;5.2;63;2\n2;5.4;63;2\n", True),
    "a row that begins like a comment": (TENSION + "0;5.0;63;2\n!1;5.2;63;2\n2;5.4;63;2\n3;5.6;63;2\n", True),
    "no unit of the first column": ("Time|Length|Air\n|m|m3/h\n9:59:01|5|63\n9:59:02|5.2|63\n9:59:03|5.4|63\n", None),
    "a long word above the header": ("9" * 30_000 + "x\n" + TENSION + "0;5.0;63;2\n1;5.2;63;2\n2;5.4;63;2\n", None),
    "many spaces in a heading": (
        f"{TENSION[:-1]};a{' ' * 20_000}b\n0;5.0;63;2;1\n1;5.2;63;2;1\n2;5.4;63;2;1\n", True
    ),
    "many spaces in a cell": (TENSION + f"0;5.0;63;2{' ' * 60_000}!\n1;5.2;63;2\n2;5.4;63;2\n", False),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_damage_that_mutants_found(name, tmp_path):
    path, (content, with_note) = tmp_path / "rig.log", MUTANTS[name]
    path.write_text(content)
    if with_note is False:
        with pytest.raises(FileError, match=f"^{re.escape(str(path))}"):
            read(path)
        return
    log = read(path)
    assert log.inserted_length[-1] in (5.4, 5.6)
    assert bool(log.notes) == bool(with_note)


def rig(path, tensions, head="tension [N]", times=range(8), time="time [s]"):
    """Write a log with these tensions, at 0.2 m/s."""
    rows = (f"{t};{5 + 0.2 * k:.1f};0.2;63;{n}" for k, (t, n) in enumerate(zip(times, tensions, strict=True)))
    path.write_text("\n".join([f"{time};length [m];feed [m/s];air [m3/h];{head}", *rows]))
    return path


TENSIONS = ["2.0", "2.1", "2.2", "2.3", "2.4", "2.5", "2.6", "2.7"]
RAMP = pytest.approx([2.0, 2.1, 2.2, 2.3, 2.4, 2.5, 2.6, 2.7])


def test_markers_of_missing_values_are_interpolated_and_counted(tmp_path):
    path = tmp_path / "rig.csv"
    markers = "-999.25 -9999 9999 -999 -7999 6999 -888.88 32767 9.9E+37 1.#QNAN -1.#IND -nan(ind) NAN"
    for marker in markers.split():
        for cells in ([marker, "2.4"], [marker, marker]):
            log = read(rig(path, [*TENSIONS[:3], *cells, *TENSIONS[5:]]))
            assert log.measured["root_tension"] == RAMP, marker
            assert log.repairs.missing == cells.count(marker)
            assert len(log.notes) == marker[-1].isdigit()
    for marker in ("Bad", "-1", "0,0", "1.#INF", "+++++++"):
        log = read(rig(path, [*TENSIONS[:3], marker.replace(",", "."), *TENSIONS[4:]]), missing=(marker,))
        assert log.measured["root_tension"] == RAMP
        assert log.time[0] == 0.0  # numbers of time are no markers
    path.write_text(lines(head=MS_HEAD, row="{c};0;{x};{v};{a}", c="%H:%M:%S"))
    assert read(path, missing=("0",)).time == pytest.approx([0, 1, 2, 3])
    las = "~V\nVERS. 2.0:\n~W\nNULL. -1 :\n~C\nTIME.S:\nLENGTH.M:\nAIR.M3/H:\nTENSION.N:\n~A\n"
    path.write_text(las + "\n".join(f"{k} {5 + 0.2 * k:.1f} 63 {-1 if k == 3 else 2 + 0.1 * k}" for k in range(8)))
    assert read(path).measured["root_tension"] == RAMP


def test_numbers_that_are_no_markers(tmp_path):
    path = rig(tmp_path / "rig.csv", [f"{tension} N" for tension in TENSIONS])
    assert read(path).measured["root_tension"] == RAMP
    path.write_text(path.read_text().replace("2.4 N", "NaN"))
    assert read(path).measured["root_tension"] == RAMP
    path.write_text(path.read_text().replace("2.3 N", "2.3 kN"))
    with pytest.raises(FileError, match=r"line 2, column 'tension \[N\]': '2.0 N' is not a.* heading: correct it$"):
        read(path)
    log = read(rig(path, [f"-{600 + k}" if k != 3 else "-999.25" for k in range(8)]))
    assert log.measured["root_tension"][3] == pytest.approx(-603.0)
    path.write_text("time [s];length [mm];air [m3/h]\n0;9599;63\n1;9799;63\n2;9999;63\n3;10199;63")
    log = read(path)
    assert log.inserted_length[2] == pytest.approx(9.999, abs=1e-6)
    assert (log.repairs.missing, log.notes) == (0, ())


def test_a_group_of_thousands_does_not_begin_with_zero(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("time [s];length [mm];air [m3/h]\n0;0.500;63\n1;0.600;63")
    with pytest.raises(FileError, match=r"'0.500' is not a finite number with the decimal sign ','"):
        read(path, decimal="comma")


def test_repeated_overload_must_be_declared(tmp_path):
    path = tmp_path / "rig.csv"
    overloads = ["327.67", "-327.68", "327.67", "-327.68", "327.67"]
    for marked in (overloads[:1] + overloads[2:3], overloads[:3]):
        rig(path, [*TENSIONS[:3], *marked, *TENSIONS[3 + len(marked) :]])
        with pytest.raises(FileError, match=r"line 5, column 'tension \[N\]': 327.67 repeats.*--missing=327.67"):
            read(path)
        assert read(path, missing=("327.67", "-327.68")).measured["root_tension"] == RAMP
    assert read(path, missing=("nan",)).measured["root_tension"].max() == 327.67
    path.write_text(HEAD + "".join(f"\n{t};{5 + 0.2 * t:.1f};0.2;{655.35 if t in (3, 4) else 63}" for t in range(8)))
    with pytest.raises(FileError, match=r"line 5, column 'air \[m3/h\]': 655.35 repeats"):
        read(path)
    path.write_text(HEAD + "".join(f"\n{t};{5 + 0.2 * t:.1f};0.2;{63 if t > 2 else 0.5}" for t in range(8)))
    assert read(path).notes == ()  # the air is switched on


def test_columns_that_are_not_read_are_told_with_what_they_may_be(tmp_path):
    path = tmp_path / "rig.csv"
    head = (
        "time [s];length [m];air [m3/h];Seilkraft [daN];Schwingung radial eff. [g];Raumtemp. [°C];Bemerkung;spare [N]"
    )
    path.write_text("\n".join([head, *(f"{t};{5 + 0.2 * t:.1f};63;0.3;0.1;20;;1" for t in range(5))]))
    unread = "'Seilkraft [daN]', 'Schwingung radial eff. [g]', 'Raumtemp. [°C]', 'Bemerkung'"
    options = ["--columns 'Seilkraft=root_tension'"]
    options += [f"--columns 'Schwingung radial eff.={axis}_acceleration_rms'" for axis in ("radial", "axial")]
    hint = f" If they are measurements: {', '.join(options)}."
    assert read(path, ("spare=none",)).notes == (f"Not read: {unread}.{hint}",)
    used = ("spare=none", "Seilkraft=root_tension", "Schwingung radial eff.=none", "Raumtemp.=none", "Bemerkung=none")
    assert read(path, used).notes == ()


def test_minutes_and_seconds(tmp_path):
    path, clocks = tmp_path / "rig.csv", [f"{k // 60 % 60:02}:{k % 60:02}.5" for k in range(3596, 3604)]
    log = read(rig(path, TENSIONS, times=clocks, time="Time"))
    assert log.time == pytest.approx(list(range(8)))
    assert log.notes == ("The column 'Time' is read as mm:ss; for hh:mm, --time-format %H:%M.",)
    log = read(rig(path, TENSIONS, times=[f"59:{52 + k}" if k < 8 else f"60:0{k - 8}" for k in range(8)]))
    assert log.time[-1] == 7.0
    rig(path, TENSIONS[:3], times=["23:59", "00:00", "00:01"])
    log = read(path, ("feed=none",), Bounds(gap=60.0), time_format="%H:%M")
    assert log.time[-1] == 120.0
    path.write_text("Time [hh:mm];length [m];air [m3/h]\n9:58;5;63\n9:59;5.2;63\n10:00;5.4;63")
    assert read(path, bounds=Bounds(gap=60.0)).time[-1] == 120.0
    path.write_text("Time;length [m];air [m3/h]\n9:58;5;63\n9:59;11;63\n10:00;17;63")
    with pytest.raises(FileError, match=r"the fastest feed is 2 m/s - The column 'Time' is read as mm:ss; for hh:mm"):
        read(path)


def test_times_without_a_unit_are_seconds_in_logs_only(tmp_path):
    path = tmp_path / "plan.csv"
    path.write_text(lines(head=HEAD.replace("time [s]", "Time")))
    assert read(path).notes == ("The column 'Time' has no unit and is read as seconds.",)
    path.write_text("Time;feed [m/s];air [m3/h]\n0;0.3;63\n1;0.2;63")
    with pytest.raises(FileError, match="column 'Time' has no unit - correct the file: a schedule has heads like"):
        read_schedule(path)
    path.write_text("Time [hh:mm];feed [m/s];air [m3/h]\n0:00;0.3;63\n0:05;0.2;63")
    assert read_schedule(path).position == (0.0, 300.0)


def test_the_form_of_times_is_declared(tmp_path):
    path = tmp_path / "rig.csv"
    for form, times in {
        "%d.%m.%y %H:%M:%S": [f"31.12.24 23:59:5{k}" for k in range(8)],
        "%Hh%Mm%Ss": [f"23h59m{k}s" for k in range(56, 60)] + [f"00h00m0{k}s" for k in range(4)],
        "%H%M%S": [f"2359{k}" for k in range(56, 60)] + [f"00000{k}" for k in range(4)],
        "%Y-%j %H:%M:%S": [f"2025-063 09:00:0{k}" for k in range(8)],
    }.items():
        log = read(rig(path, TENSIONS, times=times, time="Time"), time_format=form)
        assert log.time == pytest.approx(list(range(8)))
    with pytest.raises(FileError, match="line 2, column 'Time': '2025-063 09:00:00' is not a time of the form '%H:%M'"):
        read(path, time_format="%H:%M")
    with pytest.raises(ValueError, match="time_format = '%Q' is not a form of time: 'Q' is a bad directive"):
        read(path, time_format="%Q")


def test_summer_time_by_a_form_and_beside_dates(tmp_path):
    """A log from Saturday, 23:00, to Sunday, 4:00, with a row each 50 s, over the end and the begin of summer time."""
    path = tmp_path / "rig.csv"
    for begin, fold in ((datetime(2025, 10, 25, 23), 1), (datetime(2025, 3, 29, 23), -1)):
        moments = [begin + timedelta(seconds=50 * k) for k in range(400)]
        clocks = [m - timedelta(hours=fold) * (m >= begin + timedelta(hours=4 if fold == 1 else 3)) for m in moments]
        for head, form, time_format in (
            ("Zeit", "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S"), ("Datum;Zeit", "%d.%m.%Y;%H:%M:%S", ""),
        ):  # fmt: skip
            rows = (f"{clock.strftime(form)};{5 + 0.01 * k:.2f};63" for k, clock in enumerate(clocks))
            path.write_text("\n".join([f"{head};length [m];air [m3/h]", *rows]))
            log = read(path, bounds=Bounds(gap=60.0, every=60.0), time_format=time_format)
            assert log.time[-1] == 50.0 * 399
            assert "summer time" in log.notes[0]


def test_unneeded_feed_column_is_left_out(tmp_path):
    path = tmp_path / "rig.csv"
    for feed, value, problem in (
        ("speed [rpm]", "1450", "column 'speed [rpm]': 'rpm' is not a unit of feed_speed."),
        ("speed", "1450", "column 'speed' has no unit."),
        ("speed [m/s]", "auto", "line 2, column 'speed [m/s]': 'auto' is not a finite number."),
        ("speed [m/s]", "", "the feed speed, line 2, column 'speed [m/s]': no value in the whole column."),
    ):
        path.write_text(lines(head=f"time [s];length [m];{feed};air [m3/h]", row=f"{{t}};{{x}};{value};{{a}}"))
        log = read(path)
        assert log.notes == (f"Left out, as there is an encoder: {problem}",)
        assert log.feed_speed == pytest.approx([0.2] * 4, abs=1e-5)
        path.write_text(lines(head=f"time;{feed};air [m3/h]", row=f"{{t}};{value};{{a}}"))
        with pytest.raises(FileError):
            read(path)  # here it is needed


def test_invalid_times_are_refused(tmp_path):
    path, seconds = tmp_path / "rig.csv", range(8)
    for origin in (45_720.5, 738_949.5):  # Excel, MATLAB
        log = read(rig(path, TENSIONS, times=[f"{origin + t / 86_400:.9f}" for t in seconds], time="Time"))
        assert log.time == pytest.approx(list(seconds), abs=1e-4)
        assert "is read as serial days" in log.notes[0]
    rig(path, TENSIONS, times=[f"{9.5 + t / 3600:.7f}" for t in seconds], time="Time")
    with pytest.raises(FileError, match=r"without a unit, rows are less.*--columns 'Time=time\[UNIT\]'"):
        read(path)
    assert read(path, ("Time=time[h]",)).time == pytest.approx(list(seconds), abs=1e-3)
    with pytest.raises(FileError, match="less than 1 s"):
        read(rig(path, TENSIONS, times=[f"{45_720 + t / 86_400:.9f}" for t in seconds], time="Time [s]"))
    apart = r"rows are 1000 s apart or more, .*is the unit of time right\? .*'Time=time\[UNIT"
    with pytest.raises(FileError, match=apart):
        read(rig(path, TENSIONS, times=[1000 * t for t in seconds], time="Time"))
    rig(path, TENSIONS * 20, times=[f"{t / 60:.9f}" for t in range(160)], time="Time")
    with pytest.raises(FileError, match=r"encoder moves 31.8 m, and speed times time is 0.53 m: is the unit of time"):
        read(path)
    with pytest.raises(FileError, match=r"at 12 m/s, but the fastest feed is 2 m/s - are the units of time and length"):
        read(path, ("feed=none",))


def test_a_wrong_unit_is_not_repaired_by_declaring_another(tmp_path):
    path = rig(tmp_path / "rig.csv", TENSIONS, head="tension [V]")
    wrong = (
        "column 'tension [V]': 'V' is not a unit of root_tension - convert the column to N in the file,"
        " give a factor, --columns 'tension=root_tension[N/1000]', or leave it out"
    )
    for columns in ((), ("tension=root_tension[N]",)):
        with pytest.raises(FileError, match=re.escape(f"{wrong}, --columns 'tension=none'") + "$"):
            read(path, columns)
    assert "root_tension" not in read(path, ("tension=none",)).measured
    for unit in ("%", "°C", "1/min", "rpm", "bar", "RPM", "PSI", "LBS"):
        with pytest.raises(FileError, match=f"'{unit}' is not a unit of root_tension - convert the column to N"):
            read(rig(path, TENSIONS, head=f"tension [{unit}]"), ("tension=root_tension[N]",))


def test_sizes_and_pipes(tmp_path, monkeypatch):
    path = tmp_path / "rig.xlsx"
    path.write_bytes(BAD.encode() + b"\r\n" + bytes(800))
    log = read(path)
    assert log.inserted_length == pytest.approx([5.0, 5.2, 5.4, 5.6], abs=2e-6)
    assert log.notes == ("800 NUL bytes behind the last line, as of a power cut, were cut off.",)
    path.write_bytes(with_part(b'ref="A1:C3"', b'ref="A1:XFD1048576"'))
    assert read(path, sheet="Messung").repairs.rows == 2
    named = tmp_path / "rig.xlsx#Messung"  # as the app and evaluate accept it
    assert read(named).repairs.rows == 2
    assert read_schedule(named).feed_speed == (0.2, 0.2)
    with pytest.raises(FileError, match="no sheet 'Messwerte'; there are 'Notizen', 'Messung'"):
        read_schedule(tmp_path / "rig.xlsx#Messwerte")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileError, match="a pipe or a device"):
        read(tmp_path / "pipe")
    monkeypatch.setattr("probe_agents.records.sources.MAX_BYTES", 100)
    with pytest.raises(FileError, match="bytes are more than the 100"):
        read(path)


def test_passes_of_a_log(tmp_path):
    path = tmp_path / "rig.csv"
    way = [5.0, 5.5, 6.0, 6.5, 6.5, 5.9, 5.0, 5.5, 6.1, 6.7]
    path.write_text("time [s];length [m];air [m3/h]\n" + "\n".join(f"{t};{x};63" for t, x in enumerate(way)))
    passes = "1: insertion, lines 2 to 6, 5 to 6.5 m; 2: withdrawal, lines 6 to 8, 6.5 to 5 m; 3: insertion, lines 8 to"
    with pytest.raises(FileError, match=rf"3 passes \({passes} 11, 5 to 6.7 m\): choose one, --pass NUMBER"):
        read(path)
    for passage, lengths in {"1": way[:5], "out": [5.0, 5.9, 6.5], "3": way[6:]}.items():
        log = read(path, passage=passage)
        assert log.inserted_length == pytest.approx(lengths, abs=1e-3)
        assert log.time == pytest.approx(range(len(lengths)))
        assert f"Pass {2 if passage == 'out' else passage} of 3 is read" in log.notes[0]
    path.write_text("time [s];speed [m/s];air [m3/h]\n" + "".join(f"{t};{-0.2};63\n" for t in range(20)))
    with pytest.raises(FileError, match=r"negative throughout: is its sign reversed .*or is it a withdrawal"):
        read(path)
    assert read(path, passage="out").feed_speed == pytest.approx([0.2] * 20)


def test_options_that_do_not_fit(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text(BAD)
    for options, message in (
        ({"rate": 10.0}, "the column 'time [s]' is the time: leave --rate out, or --columns 'time=none'"),
        ({"rate": 0.0}, "rate = 0.0 Hz is outside the accepted range 0.001 to 1e+06 Hz"),
        ({"passage": "back"}, "pass = 'back' is not in, out or the number of a pass"),
        ({"passage": "2"}, "one pass (insertion, lines 2 to 5, 5 to 5.6 m): a log is of an insertion"),
        ({"encoding": "cp0"}, "encoding = 'cp0' is not known, unlike utf-8, cp1252, cp932 or cp1251"),
        ({"sheet": "A"}, "not a workbook, so it has no sheet 'A': leave --sheet out"),
        ({"decimal": "dot"}, "decimal = 'dot' is not one of auto, point, comma"),
        ({"columns": ("length=inserted_length[m/0]",)}, "a factor is a finite number with a unit, like [-m/4096]"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            read(path, **options)
    plan = tmp_path / "plan.csv"
    plan.write_text("time_s,inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n0,5,0.2,63\n100,5.02,0.2,63\n")
    with pytest.raises(FileError, match=r"inserted_length_m rises by 0.02 m, and speed times time is 20 m: is the"):
        read_schedule(plan)
    plan.write_text("from [m];to [m];feed [m/s];air [m3/h]\n5;25;0.3;63\n26;60;0.2;63")
    with pytest.raises(
        FileError, match=r"line 2, column 'to \[m\]': the section does not end where the next one begins"
    ):
        read_schedule(plan)


def test_invalid_columns_and_bounds_are_refused(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text(BAD)
    for columns, message in {
        ("feed",): "columns = 'feed' is not HEAD=QUANTITY",
        ("feed=speed",): "columns = 'feed=speed' is not HEAD=QUANTITY",
        ("a=time", "b=time"): "columns = 'b=time': time is named twice",
        ("nowhere=time",): "column 'nowhere' of --columns does not exist; found: 'time [s]'",
        ("feed=feed_speed", "feed=rf_noise_rms"): "column 'feed' is named twice in --columns",
        ("feed=feed_speed[kg]",): "column 'feed [m/s]': 'kg' is not a unit of feed_speed",
    }.items():
        with pytest.raises(ValueError, match=re.escape(message)):
            read(path, columns)
    for bounds, problem in (
        ({"gap": 0.0}, "gap = 0.0 s is outside the accepted range 0.001 to 3600 s"),
        ({"every": 6.0}, "every = 6 s is more than gap = 5 s"),
        ({"tolerance": float("nan")}, "tolerance = nan m is outside the accepted range 1e-05 to 0.1 m"),
        ({"backward": -1.0}, "backward = -1.0 m is outside the accepted range 0 to 1 m"),
    ):
        with pytest.raises(ValueError, match=problem):
            Bounds(**bounds)
