"""Robustness: what an axis changes, that it is paired with the undisturbed task, and that it goes on where it was."""

import json

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from agents.cli import main
from agents.policies.places import place_of
from agents.processes.workers import Workers
from agents.records.columns import COST_KPIS
from agents.records.reading import FileError, read_csv
from agents.robustness import figures
from agents.robustness.axes import AXES, NOMINAL, disturbed
from agents.robustness.study import COLUMNS, cells, cost_cells, folder_of, run_study, summary_of, worst_of
from agents.rollouts import plan
from probe_env import Plant, TaskConfig

SHORT = Plant.model_validate({"tube": {"helix_length": 7.0, "helix_diameter": [1.0, 1.4]}})


def changed(config, other):
    """Names of what differs, with a dot where it is in the scene."""
    given, altered = config.model_dump(), other.model_dump()
    names = {name for name in given if name != "scene" and given[name] != altered[name]}
    for part in ("tube", "probe", "contact", "air"):
        mine, theirs = given["scene"][part], altered["scene"][part]
        names |= {f"{part}.{name}" for name in mine if mine[name] != theirs[name]}
    return names


def test_every_axis_changes_what_it_says_and_nothing_else():
    config = TaskConfig()
    by_axis = {}
    for setting in disturbed(config):
        by_axis.setdefault(setting.axis, []).append((changed(config, setting.config), setting.config))
    assert tuple(by_axis) == (NOMINAL, *AXES)
    names = {axis: set().union(*(each for each, _ in settings)) for axis, settings in by_axis.items()}
    assert names == {
        NOMINAL: set(),
        "delay": {"delay_periods"},
        "noise": {"rf_noise", "tension_noise"},
        "dropout": {"sensor_dropout"},
        "air lag": {"air_lag"},
        "friction drift": {"friction_drift"},
        "oval tube": {"tube.ovality"},
        "probe": {"probe.guide_length", "probe.guide_float_diameter", "probe.carrier_float_diameter"},
        "bore": {"tube.inner_diameter"},
    }
    assert [config.delay_periods for _, config in by_axis["delay"]] == [1, 2, 3]
    assert [round(1e3 * config.scene.tube.inner_diameter, 2) for _, config in by_axis["bore"]] == [22.12, 26.28]
    folders = [folder_of(setting) for setting in disturbed(config)]
    assert len(set(folders)) == len(folders)


def test_a_delay_is_in_seconds_whatever_the_period():
    settings = disturbed(TaskConfig(period=0.5), ("delay",))
    assert [setting.config.delay_periods for setting in settings] == [0, 2, 4, 6]


@pytest.mark.parametrize("axes", [("dealy",), ("delay", "delay")])
def test_axes_that_are_none_are_refused(axes):
    with pytest.raises(ValueError, match="accepted, once each, are delay, noise"):
        disturbed(TaskConfig(), axes)


def episodes():
    """Two policies on three tubes: one loses 1, 2 and 3 with a delay, and its drive once; the other nothing."""
    rows = []
    for policy, loss in (("first", 1.0), ("second", 0.0)):
        for axis, value, far in ((NOMINAL, "", 0.0), ("delay", "2 s", 1.0)):
            for tube in range(3):
                row = {"policy": policy, "context": tube, "seed": 0, "axis": axis, "value": value, "diverged": 0.0}
                lost = float(loss * far > 0.0 and tube == 2)
                row |= {"reward": 10.0 * tube - loss * far * (tube + 1), "lost_drive": lost}
                rows.append(row | dict.fromkeys(COST_KPIS, 3.0 * lost))
    return pd.DataFrame(rows)


def test_changes_are_paired_tube_by_tube():
    """Rewards scatter by 10, and what is lost by 1 only: the interval knows the latter."""
    summary = summary_of(episodes())
    assert list(summary.columns) == list(COLUMNS)
    first, second = (
        summary[(summary["policy"] == name) & (summary["axis"] == "delay")] for name in ("first", "second")
    )
    assert first["change"].item() == pytest.approx(-2.0)
    assert -3.0 <= first["low"].item() < -2.0 < first["high"].item() <= -1.0
    assert second[["change", "low", "high"]].to_numpy().tolist() == [[0.0, 0.0, 0.0]]
    assert first["cost"].item() == pytest.approx(1.0)
    assert cells(summary)[0] == ("nominal", "10.0", "10.0")
    assert cost_cells(summary)[1] == ("delay, 2 s", "1 (33 % lost)", "0")
    assert worst_of(summary)["first"][0] == "delay 2 s"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A short helix, two tubes, a policy that looks at nothing and one that draws by what it sees: folder and table."""
    output = tmp_path_factory.mktemp("robustness")
    axes = ("delay", "noise", "dropout", "friction drift")
    return output, run_study(["constant", "random"], place_of(SHORT, "test", 2), "fast", output, Workers(), axes)


def test_who_looks_at_nothing_loses_nothing_by_what_is_seen(study):
    """To the bit: delay, noise and dropouts are of the sensors, and move nothing."""
    _, summary = study
    blind = summary[summary["policy"] == "constant"].set_index("axis")
    for axis in ("delay", "noise", "dropout"):
        assert (blind.loc[[axis], ["change", "low", "high"]].to_numpy() == 0.0).all()
    assert (blind.loc["friction drift", "change"] != 0.0).all()
    seeing = summary[summary["policy"] == "random"].set_index("axis")
    for axis in ("delay", "noise", "dropout"):
        assert (seeing.loc[[axis], "change"] != 0.0).all()


def test_what_is_stored_is_not_played_again_and_can_be_read(study, monkeypatch):
    output, summary = study
    monkeypatch.setattr(plan, "_lines", lambda *_: pytest.fail("played again"))
    axes = ("delay", "noise", "dropout", "friction drift")
    repeated = run_study(["constant", "random"], place_of(SHORT, "test", 2), "fast", output, Workers(), axes)
    pd.testing.assert_frame_equal(repeated, summary)
    stored = read_csv(output / "robustness.csv", COLUMNS)
    assert np.allclose(stored["reward"], summary["reward"], rtol=1e-4)
    assert (output / "robustness.png").stat().st_size > 0
    assert json.loads((output / "provenance.json").read_text())["limit"] == 2


def test_a_table_that_is_damaged_is_told(study, tmp_path):
    text = (study[0] / "robustness.csv").read_text()
    damaged = tmp_path / "robustness.csv"
    damaged.write_text(text.replace("reward", "rewards", 1))
    with pytest.raises(FileError, match="column 'reward' is missing"):
        read_csv(damaged, COLUMNS)


def test_the_command_refuses_what_is_not_valid_before_any_work(tmp_path, capsys):
    for arguments, message in (
        (["nobody", "--limit", "1"], "policy = 'nobody' is not one of"),
        (["constant", "--limit", "99"], "limit = 99"),
        (["constant", "--limit", "1", "--axes", "wind"], "axes = wind: accepted"),
    ):
        assert main(["robustness", *arguments, "--output", str(tmp_path / "out")]) != 0
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("policies", [1, 2, 3, 4, 7, 9])
def test_every_column_of_the_picture_has_numbers_below_it(policies, monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(figures, "save", lambda figure, path: drawn.append(figure) or path)
    one = summary_of(episodes()).query("policy == 'first'")
    figures.draw_profiles(pd.concat([one.assign(policy=f"p{k}") for k in range(policies)]), tmp_path / "p.png")
    (figure,) = drawn
    panels = [axis for axis in figure.axes if axis.get_visible()]
    assert len(panels) == policies
    lowest = {axis.get_subplotspec().colspan.start: axis for axis in panels}  # from the top down
    for axis in panels:
        shown = axis.xaxis.get_tick_params()["labelbottom"]
        assert shown == (axis is lowest[axis.get_subplotspec().colspan.start])
    plt.close(figure)
