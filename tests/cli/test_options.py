"""Options: mistyped ones and values are one line, quantities have units, help breaks where the terminal ends."""

import re

import pytest

from agents.cli import main
from agents.cli.registry import COMMANDS


def test_what_is_not_understood_is_one_line(capsys, monkeypatch):
    failures = []
    for arguments, message in (
        ("evaluate --limi 3", "Unrecognized options: --limi, 3; Perhaps you meant: --limit INT"),
        ("evaluate --limi=3", "Perhaps you meant: --limit INT"),
        ("evaluate --zzzz", "Unrecognized options: --zzzz"),
        ("evaluate --limit x", "Error parsing --limit: invalid literal for int() with base 10: 'x'"),
        ("evaluate pi --limit", "Missing value for argument '--limit'. Expected 1 values."),
        ("evaluate --contexts tset", "invalid choice 'tset' for argument '--contexts'. Expected one of ('train', "),
        ("render --duration 1s", "Error parsing --duration: could not convert string to float: '1s'"),
        ("simulate", "Missing from probe-env simulate: PATH Scene file (TOML)"),
        ("simulate fig11_l10 fig11_l20", "Unrecognized options: fig11_l20"),
        ("simulate fig11_l10 --scene.air.drag 1", "Perhaps you meant: --scene.air.drag-coefficient"),
        ("simulate fig11_l10 --scene.carrier-lenght 3", "Perhaps you meant: --scene.carrier-length"),
        ("simulate fig11_l10 --scene.contact.friction -1", "--scene.contact.friction: -1.0 is outside the accepted"),
    ):
        for columns in ("60", "200"):
            monkeypatch.setenv("COLUMNS", columns)
            status = main(arguments.split())
            out, err = capsys.readouterr()
            line = err.removeprefix("probe-env: error: ").removesuffix("\n")
            if (status, out) != (2, "") or message not in line or re.search("[─│╭╰\n]", line):
                failures.append((arguments, columns, err))
    assert failures == []


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
