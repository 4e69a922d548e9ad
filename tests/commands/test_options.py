"""Options: mistyped ones and values are one line, quantities have units, help breaks where the terminal ends."""

import re

import pytest

from agents.cli import main
from agents.commands.feed import Evaluate
from agents.commands.registry import COMMANDS
from agents.commands.study import Simulate
from agents.terminal.command_line import parsed
from agents.terminal.tyro_texts import joined_lines, message_of


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("evaluate --limi 3", "there is no option --limi; the closest: --limit"),
        ("evaluate --limi=3", "there is no option --limi; the closest: --limit"),
        ("evaluate --zzzz", "there is no option --zzzz (probe-env evaluate --help tells all)"),
        ("evaluate --limit x", "Error parsing --limit: invalid literal for int() with base 10: 'x'"),
        ("evaluate pi --limit", "Missing value for argument '--limit'. Expected 1 values."),
        ("evaluate --contexts tset", "invalid choice 'tset' for argument '--contexts'. Expected one of ('train', "),
        ("render --duration 1s", "Error parsing --duration: could not convert string to float: '1s'"),
        ("simulate", "Missing from probe-env simulate: PATH Scene file (TOML)"),
        ("simulate fig11_l10 fig11_l20", "Unrecognized options: fig11_l20"),
        (
            "simulate fig11_l10 --scene.air.drag 1",
            "no option --scene.air.drag; accepted behind --scene.air.: d",
        ),
        (
            "simulate fig11_l10 --scene.carrier-lenght 3",
            "no option --scene.carrier-lenght; accepted behind --scene.: carrier-length, ",
        ),
        ("design --contexts 4", "invalid choice '4' for argument '--contexts'. Expected one of ('train', "),
    ],
)
@pytest.mark.parametrize("columns", ["40", "200"])
def test_what_is_not_understood_is_one_line(arguments, message, columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    assert main(arguments.split()) == 2
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert out == ""
    assert line.startswith("probe-env: error: ")
    assert message in line
    assert not re.search("[─│╭╰]|--- ", line)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("calibrations --limit 7", "logs = 7 must be a multiple of 8"),
        ("recommendations --limit 7", "tubes = 7 must be a multiple of 8"),
        ("response --limit 0", "groups = 0 is outside the accepted range 1 to 256"),
    ],
)
def test_limit_is_how_many_of_what_a_command_counts(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments.split()) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_message_is_found_in_a_box_and_below_a_rule():
    box = (
        "╭─ Value error ──╮",
        "│ Error parsing  │",
        "│ --x: no        │",
        "│ ────────────── │",
        "│ more           │",
        "╰─╯",
    )
    assert message_of("\n".join(box)) == "Error parsing --x: no"
    assert message_of(" Value error   \n ------------- \n  Error: no  \n  -----------\n  more\n") == "Error: no"
    assert message_of("no box\nat all") == "no box at all"


def entries(name, capsys, monkeypatch):
    """The options of a command with what its help says of each."""
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit):
        main([name, "--help"])
    texts = []
    for line in (line.strip("│ ") for line in capsys.readouterr().out.splitlines()):
        if re.match("--?[a-z]", line):
            texts.append(line)
        elif texts:
            texts[-1] += f" {line}"
    return texts


@pytest.mark.parametrize("name", COMMANDS)
def test_every_quantity_has_a_unit(name, capsys, monkeypatch):
    options = entries(name, capsys, monkeypatch)
    assert "-h, --help" in options[0]
    assert [
        text for text in options if "FLOAT" in text and not re.search(r"\[[^]]+\]", text.split("FLOAT", 1)[1])
    ] == []


def test_help_breaks_where_the_terminal_ends_and_not_where_the_source_does(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "4000")
    with pytest.raises(SystemExit):
        main(["evaluate", "--help"])
    page = capsys.readouterr().out
    assert "schedule files (.csv, .toml), feedback laws" in page
    assert "the training seeds of one method" in page
    assert joined_lines("One\n    (two)\n\n  three.\n") == "One (two)\n\nthree."


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_the_terminal(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([name, "--help"])
    page = capsys.readouterr().out
    assert [line for line in page.splitlines() if len(line) > 80 and not line.startswith("usage")] == []
    assert "\u2060" not in page


def test_a_file_whose_name_begins_with_a_dash_is_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("-x.csv", "-1"):
        (tmp_path / name).write_text("")
    assert parsed("evaluate", Evaluate, ["-x.csv"], "").policies == ("./-x.csv",)
    with pytest.raises(ValueError, match=r"-y\.csv"):  # there is no such file
        parsed("evaluate", Evaluate, ["-y.csv"], "")
    assert parsed("simulate", Simulate, ["a.toml", "--time-step", "-1"], "").time_step == -1.0  # a number stays one


@pytest.mark.parametrize("words", ["design --storge", "tune", "evaluate", "evaluate pi --storage"])
def test_a_password_in_a_mistyped_line_is_not_shown(words, capsys):
    assert main([*words.split(), "postgresql://u:hunter2@h/db"]) == 2
    assert "hunter2" not in "".join(capsys.readouterr())
