"""Help and options: mistyped options and values are one line, quantities have units."""

import re

import pytest

from probe_agents.cli import main
from probe_agents.cli.parsing import parse_fidelity, positional
from probe_agents.cli.registry import COMMANDS, first_page
from probe_env import Fidelity
from probe_env.fidelity import resolve_fidelity
from probe_env.physics.methods import METHODS


def test_the_first_page_has_every_command_once(capsys):
    for arguments, status in (([], 2), (["-h"], 0), (["--help"], 0)):
        assert main(arguments) == status
        assert capsys.readouterr().out == first_page() + "\n"
    assert max(map(len, first_page().splitlines())) <= 80


def test_every_help_has_an_example_and_units(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    failures = []
    for name in COMMANDS:
        with pytest.raises(SystemExit) as done:
            main([name, "--help"])
        options, page = [], capsys.readouterr().out
        for line in (line.strip("│ ") for line in page.splitlines()):
            if re.match("--?[a-z]", line):
                options.append(line)
            elif options:
                options[-1] += f" {line}"
        quantities = [text.split("FLOAT", 1)[1] for text in options if "FLOAT" in text]
        failures += [(name, text) for text in quantities if not re.search(r"\[[^]]+\]", text)]
        if done.value.code or f"Example: probe-env {name}" not in page:
            failures.append(name)
        if name == "simulate":
            meanings = page[page.index("--method") : page.index("--time-step")].partition("}")[2]
            failures += [method for method in METHODS if not re.search(rf"\b{method}\b", meanings)]
    assert failures == []


def test_the_scene_is_found_among_the_options():
    for arguments, scene in (
        (["fig11_l10", "--duration", "1"], "fig11_l10"),
        (["--duration", "1", "--output=x", "-h", "fig11_l10"], "fig11_l10"),
        (["--scene.contact.friction", "-1", "--", "-x.toml"], "-x.toml"),
        (["--help"], None),
        (["--duration"], None),
    ):
        assert positional(arguments) == scene


def test_a_fidelity_is_a_name_or_settings():
    settings = Fidelity(method="superelement32", time_step=1e-4, time_lapse=4.0)
    assert parse_fidelity("fast") == "fast"
    assert resolve_fidelity(parse_fidelity(str(settings.model_dump()))) == settings
    assert parse_fidelity(" {'method': 'imex'}") == Fidelity(method="imex")
    for text, message in (
        ("{'method'", "fidelity = \"{'method'\" is neither a name nor settings"),
        ("{'method': open('x')}", "is neither a name nor settings"),
        ("{'methd': 'imex'}", "fidelity.methd: there is no such field; accepted: method, time_step"),
        ("{'method': 'euler'}", "fidelity.method"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            parse_fidelity(text)
