"""Tables are never wider than the terminal, and nothing in them is lost."""

from rich.cells import cell_len

from probe_agents.terminal.tables import print_table

HEADER = ["policy", "reward", "inspection time [s]", "length within the limit [%]", "radial acceleration rms [m/s2]"]
ROWS = [
    ["best-schedule-by-diameter", "3.38 [-2.15, 7.62]", "364 [348, 378]", "94 [90.4, 96.2]", "29.7 [26.4, 32.8]"],
    ["pi", "-5.9 [-12.9, 1.45]", "311 [278, 349]", "86.4 [84.6, 88.6]", "29.3 [26.5, 31.5]"],
]


def test_table_fits_the_terminal(monkeypatch, capsys):
    for width in (60, 80, 100, 120, 200):
        monkeypatch.setenv("COLUMNS", str(width))
        print_table("Means [x]", HEADER, ROWS)
        text = capsys.readouterr().out
        assert max(map(cell_len, text.splitlines())) <= width
        assert text.splitlines()[0].strip() == "Means [x]"
        assert all(cell in text for row in ROWS for cell in row[1:])
        assert all(word in text for name in HEADER for word in name.split())
        tables = text.count("┏")
        assert (tables == 1) == (width >= 120)  # 107 with its headers folded
        assert text.count("pi ") == tables  # every part says whose figures it has


def test_texts_are_folded(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "40")
    print_table("Claims", ["claim", "holds"], [["vibration grows with length " * 3, "yes"]], left=2)
    out = capsys.readouterr().out
    assert max(map(cell_len, out.splitlines())) <= 40
    assert out.count("vibration") == 3
