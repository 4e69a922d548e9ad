"""Probes compared and searched in a plant's own tubes, by the commands; another plant's folder is refused."""

import json
from pathlib import Path

import pandas as pd
import pytest

from probe_agents.cli import main
from probe_agents.design.trials import DesignProblem
from probe_agents.policies.cases import load_case, read_case
from probe_env import Design

OWN = """
tube = { helix_diameter = [1.0, 1.4], inner_diameter = 19.5e-3, helix_length = 40.0 }
probe = { carrier_float_diameter = 16e-3, guide_float_diameter = 17e-3, line_density = 0.13 }
contact = { friction = { low = 0.12, high = 0.22 } }
feed = { feed_speeds = [0.03, 0.25] }
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(OWN)
    (tmp_path / "other.toml").write_text(OWN.replace("40.0", "80.0"))
    (tmp_path / "own.toml").write_text("")  # the plant's own probe
    (tmp_path / "off.toml").write_text("guide_length = 5.03\n")
    (tmp_path / "long.toml").write_text("guide_length = 10.0\nguide_float_diameter = 0.018\n")


def problem_of(name, feed="best-constant", tubes=2):
    """The search in a plant's tubes; None: the study's."""
    case = load_case(None, "train", tubes) if name is None else read_case(Path(f"{name}.toml"), "train", tubes)
    return DesignProblem.of_case(case, feed, False, "standard")


def test_designs_start_from_the_probe_of_the_plant(tmp_path, capsys, refused):
    run = ["compare", "own.toml", "long.toml", "--limit", "2", "--output", "out", "--tube"]
    assert main([*run, "mine.toml"]) == 0
    assert "of mine (bore 19.5 mm, helix 40 m)" in " ".join(capsys.readouterr().out.split())
    table = pd.read_csv("out/designs.csv")
    assert set(table["tube"]) == {"mine (bore 19.5 mm, helix 40 m)"}
    assert table[table["design"] == "own"]["inspected_m"].to_numpy() == pytest.approx(35.0)
    assert table[table["design"] == "long"]["inspected_m"].to_numpy() == pytest.approx(27.5)
    assert (tmp_path / "out" / "designs.png").stat().st_size > 20_000
    built = json.loads((tmp_path / "out" / "manifest.json").read_text())["designs"]
    assert (built["own"]["line_density"], built["long"]["line_density"]) == (0.13, 0.13)
    assert built["long"]["carrier_float_diameter"] == 0.016
    assert main(["compare", "original", "--limit", "1", "--output", "study"]) == 0
    capsys.readouterr()
    refused([*run, "other.toml"], '(tube.name "mine", now "other"; also tube.digest, task')
    refused([*run[:1], "improved", *run[3:-1]], '(tube.name "mine", now "table 2"')
    refused(["design", "--trials", "2", "--limit", "1", "--output", "out"], '(tube.name "mine", now "table 2"')
    mine = ["compare", "own.toml", "--limit", "1", "--output", "study", "--tube", "mine.toml"]
    refused(mine, '(tube.name "table 2", now "mine"')
    (tmp_path / "mine.toml").write_text(OWN.replace("0.22", "0.23"))
    refused([*run, "mine.toml"], "with other settings (tube.digest ")


def test_designs_that_do_not_fit_are_refused(tmp_path, refused):
    tight, short = OWN.replace("17e-3", "16e-3"), "helix_length = 20 m: designs are compared as far as"
    for plant, arguments, message in (
        (OWN, ["compare", "improved"], "design 'improved' in mine: probe.guide_float_diameter = 0.02 m must be less"),
        (OWN, ["compare", "off.toml"], "off.toml: guide_length = 5.03 m is not a whole multiple"),
        (OWN.replace("40.0", "20.0"), ["compare", "long.toml"], short),
        (OWN.replace("40.0", "20.0"), ["design"], short),
        (tight.replace("19.5e-3", "17.005e-3"), ["compare", "long.toml"], "must be less than"),
        (tight.replace("19.5e-3", "16.5e-3"), ["design"], "no guide_float_diameter of the"),
    ):
        (tmp_path / "mine.toml").write_text(plant)
        refused([*arguments, "--tube", "mine.toml", "--limit", "1", "--output", "out"], message)


def test_search_stays_within_what_fits_the_plant(tmp_path, capsys, monkeypatch):
    problem, other, usual = (problem_of(name) for name in ("mine", "other", None))
    assert problem.axes["guide_float_diameter"][:2] == (0.016, pytest.approx(0.0185))
    assert problem.axes["feed_speed"][1] == 0.25
    assert list(problem.probes) == ["the plant's own", "the study's improved"]
    assert problem.probes["the plant's own"].line_density == 0.13
    Path("mine.toml").write_text(OWN.replace("0.13", "0.2"))  # outside the design space
    assert list(problem_of("mine").probes) == ["the study's original", "the study's improved"]
    Path("mine.toml").write_text(OWN)
    for start in problem.starts():
        assert all(low <= start[name] <= high for name, (low, high, _) in problem.axes.items())
    with problem.search_folder(tmp_path / "problem", 0).open():
        pass
    for another, seed, changed in ((other, 0, "tube.name"), (usual, 0, "tube.name"), (problem, 1, "seed 0, now 1")):
        with pytest.raises(ValueError, match=f"these trials were simulated with other settings .{changed}"):
            another.search_folder(tmp_path / "problem", seed).check()
    assert (usual.cuts, list(usual.probes)) == ((), ["the study's original", "the study's improved"])

    monkeypatch.setattr(DesignProblem, "value", lambda _, point, workers=None: (point["guide_length"], 100.0, 1.0, 5.0))
    run = ["design", "--tube", "mine.toml", "--limit", "1", "--trials", "20", "--output", "out"]
    assert main(run) == 0
    printed = capsys.readouterr()
    assert "note: guide_float_diameter is searched from 0.016 to 0.0185 m, not from 0.016 to 0.02 m" in printed.err
    assert "in mine (bore 19.5 mm, helix 40 m)" in " ".join(printed.out.split())
    assert set(pd.read_csv("out/trials.csv")["tube"]) == {"mine (bore 19.5 mm, helix 40 m)"}
    Design.from_toml(tmp_path / "out" / "found.toml")


def test_probe_that_cannot_be_simulated_ranks_last(tmp_path, monkeypatch):
    """80 m of soft cable under full air of 3.4 times the drag, held by next to no friction: pulled too hard."""
    monkeypatch.setattr("probe_agents.design.trials.try_sections", lambda *_, **__: pytest.fail("it was simulated"))
    smooth = OWN.replace("40.0", "80.0").replace("0.12", "0.02").replace("0.22", "0.03")
    (tmp_path / "smooth.toml").write_text(smooth + "[air]\ndrag_coefficient = 1.5\n")
    problem = problem_of("smooth", tubes=1)
    soft = {name: low for name, (low, _, _) in problem.axes.items()}
    soft |= {name: problem.axes[name][1] for name in ("guide_length", "guide_float_diameter", "carrier_float_diameter")}
    squares, seconds, margin, euler = problem.value(soft | {"air_supply_rate": problem.axes["air_supply_rate"][1]})
    assert (squares, margin, euler) == (9.0, -0.8, 0.0)
    assert seconds == pytest.approx(67.5 / 0.03)


def test_search_scores_over_the_length_of_the_plant():
    """A constant feed takes the span over it: 27.5 and 67.5 m at 0.2 m/s, unless the probe does not get through."""
    for name, span in (("mine", 27.5), ("other", 67.5)):
        problem = problem_of(name, "constant", tubes=1)
        _, seconds, margin, _ = problem.value(problem.probes["the plant's own"].model_dump())
        assert seconds == pytest.approx(span / 0.2)
        assert margin > 0.0
