"""What ``probe-env`` says of itself: the first page, every command's help, and what is not a command."""

import json
import math
import re
from importlib.metadata import version

import pytest

import probe_env
from agents.cli import main
from agents.cli.parsing import positional
from agents.cli.registry import COMMANDS, FIRST, MAKERS, PLANT, USERS, first_page
from probe_env import Scene
from probe_env.physics.methods import METHODS


@pytest.mark.parametrize(("arguments", "status"), [([], 2), (["-h"], 0), (["--help"], 0)])
def test_the_first_page_shows_users_their_commands_first(arguments, status, capsys):
    assert main(arguments) == status
    page = capsys.readouterr().out
    assert page == first_page() + "\n"
    assert tuple(FIRST) == ("simulate", "evaluate", "render", "train", "compare", "design")
    assert set(USERS) == {*FIRST, *PLANT}
    places = [page.index(f"\n  {name} ") for name in (*USERS, *MAKERS)]
    assert places == sorted(places)
    assert max(map(len, page.splitlines())) <= 80


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_help_with_an_example(name, capsys):
    with pytest.raises(SystemExit) as done:
        main([name, "--help"])
    assert done.value.code == 0
    assert f"Example: {COMMANDS[name].example}" in capsys.readouterr().out.replace("\n", " ")
    assert COMMANDS[name].example.startswith(f"probe-env {name}")


def test_simulate_names_all_methods_and_units(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    page = capsys.readouterr().out
    assert f"--method {{{','.join(METHODS)}}}" in page
    meanings = page[page.index("--method") : page.index("--time-step")].partition("}")[2]
    assert [name for name in METHODS if not re.search(rf"\b{name}\b", meanings)] == []
    for option in ("--scene.feed-speed", "--scene.probe.flexural-rigidity", "--scene.contact.stiffness"):
        assert "[" in page[page.index(option) :].splitlines()[1].replace("[default", "")  # its unit


@pytest.mark.parametrize("method", METHODS)
def test_simulate_runs_every_method_with_its_usual_step(method, tmp_path, capsys):
    brief = ["--duration", "0.02", "--scene.carrier-length", "6", "--output", str(tmp_path)]
    assert main(["simulate", "fig11_l10", "--method", method, *brief]) == 0
    printed = capsys.readouterr().out
    assert f"{method}, time step {METHODS[method].usual_step:g} s" in printed
    assert "inf" not in printed
    results = json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)
    assert (results["method"], results["time_step_s"]) == (method, METHODS[method].usual_step)
    assert results["statistics"]["radial_rms_m"] > 0.0
    limit = METHODS[method].stable_step(Scene.from_toml(tmp_path / "scene.toml"), results["nodes_per_pitch"])
    assert results["stable_time_step_s"] == (limit if math.isfinite(limit) else None)


def test_the_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"probe-env {version('probe-env')}\n"
    assert probe_env.__version__ == version("probe-env")


def test_what_is_no_command_is_told_with_those_that_are(capsys):
    assert main(["simulat"]) == 2
    assert "command = 'simulat' is not one of simulate, evaluate" in capsys.readouterr().err


def test_the_agents_are_told_with_what_they_know(capsys):
    assert main(["agents"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "ppo seeds 0, 1, 2, 3, 4" in printed
    assert "the root tension" in printed
    assert "probe_env/Insertion-v1 with any probe of the design space in the train tubes" in printed
    assert "tension-scheduled first" in printed
    assert "schedules best-both-ways, example, fast-in, shift, slow-back, steady-back" in printed


@pytest.mark.parametrize(
    ("arguments", "scene"),
    [
        (["fig11_l10", "--duration", "1"], "fig11_l10"),
        (["--duration", "1", "--output=x", "-h", "fig11_l10"], "fig11_l10"),
        (["--scene.contact.friction", "-1", "--", "-x.toml"], "-x.toml"),
        (["--help"], None),
        (["--duration"], None),
    ],
)
def test_the_scene_is_found_among_the_options(arguments, scene):
    assert positional(arguments) == scene
