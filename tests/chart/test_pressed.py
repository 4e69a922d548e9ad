"""Scenes with pressure: how they are drawn, some of them run second, and what the stored tables say."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.chart.stability import lost, returns
from agents.chart.stability.pressed import (
    FRICTION,
    HELIX_DIAMETER,
    INSERTED,
    PROBES,
    SCENES,
    SHORTEST_CARRIER,
    WAYS,
    pressed_scene,
)
from agents.chart.stability.pressed_runs import (
    BARE,
    BEYOND,
    COARSE,
    CODE,
    EVERYWHERE,
    FINE,
    IMPLICIT,
    MEMBERS,
    contested,
    rows_of,
    run_group,
)
from agents.chart.stability.pressed_runs import lost as lost_scenes
from agents.chart.stability.pressed_words import compared, members
from agents.records.code_hash import code_hash
from agents.records.store import stored_rows
from probe_env.envs.contexts import STIFFNESS
from probe_env.physics.methods import METHODS

FOLDER = Path(__file__).parents[2] / "results" / "pressed"
TABLE = stored_rows(FOLDER / "scenes.csv")
MAP = stored_rows(FOLDER / "map.csv")
INSERTIONS = stored_rows(FOLDER / "insertions.csv")
DRAWN = [pressed_scene(number) for number in range(SCENES)]


def test_scenes_are_drawn_within_their_ranges_and_balanced():
    for pressed in DRAWN:
        scene, ((_, _), (feed, air)) = pressed.scene, WAYS[pressed.way]
        assert FRICTION[0] <= scene.contact.friction <= FRICTION[1]
        assert STIFFNESS[0] <= scene.contact.stiffness <= STIFFNESS[1]
        assert HELIX_DIAMETER[0] <= scene.tube.helix_diameter <= HELIX_DIAMETER[1]
        assert scene.inserted_length <= INSERTED[1]
        assert scene.carrier_length >= SHORTEST_CARRIER - scene.probe.float_pitch
        assert feed[0] <= pressed.turned.feed_speed <= feed[1]
        assert air[0] <= 3600.0 * pressed.turned.air_supply_rate <= air[1]
        assert scene.couple == "tangent"
    kinds = pd.DataFrame([(pressed.way, pressed.probe) for pressed in DRAWN]).value_counts()
    assert len(kinds) == len(WAYS) * len(PROBES)
    assert kinds.eq(SCENES / len(kinds)).all()


def test_the_steps_are_within_the_named_limits_of_all_scenes():
    for setting in EVERYWHERE:
        limits = [METHODS[setting.method].stable_step(pressed.scene, setting.nodes_per_pitch) for pressed in DRAWN]
        assert setting.time_step <= min(limits)


def test_a_scene_follows_from_its_number():
    second = pressed_scene.__wrapped__(57)
    assert second == DRAWN[57]
    assert second != DRAWN[58]


@pytest.mark.parametrize("way", list(WAYS))
def test_a_pressed_scene_ends_finite_and_is_repeated(way):
    """The shortest weak cable of each way at the step of `standard`: finite, equal to the bit when run second."""
    weak = [pressed for pressed in DRAWN if pressed.way == way and pressed.probe == "weak cable"]
    shortest = min(weak, key=lambda pressed: pressed.scene.inserted_length)
    (row,), (second,) = (run_group([shortest], FINE, 0, 1) for _ in range(2))
    assert np.isnan(row["diverged_at_s"])
    assert np.isfinite([row["tension_mean_n"], row["radial_mean_m"], row["radial_rms_m"]]).all()
    pd.testing.assert_series_equal(pd.Series(row), pd.Series(second), check_exact=True)


@pytest.mark.parametrize("number", [37, 59, 157])
def test_weak_cables_that_bounce_hold_at_fast(number):
    """The couple's tension is bounded by 3 EI/h^2 as its pressure is: without that these diverged within 4 s."""
    assert DRAWN[number].probe == "weak cable"
    (row,) = run_group([DRAWN[number]], COARSE, 0, 1)
    assert np.isnan(row["diverged_at_s"])
    assert np.isfinite([row["tension_mean_n"], row["radial_mean_m"], row["radial_rms_m"]]).all()


def test_the_stored_scenes_are_complete_and_of_this_code():
    assert (TABLE["code"] == TABLE["method"].map(lambda name: code_hash(CODE, name))).all(), "probe-env results pressed"
    for setting in EVERYWHERE:
        assert rows_of(TABLE, setting).index.tolist() == list(range(SCENES))
    assert compared(TABLE) == contested(TABLE)


def test_all_scenes_end_finite_with_the_cable_on_the_walls():
    """At the steps and meshes of `standard` and of `fast`; with floats alone half of them do not."""
    assert lost_scenes(TABLE, FINE) == lost_scenes(TABLE, COARSE) == []
    assert len(lost_scenes(TABLE, BARE)) > SCENES // 4


def test_implicit_agrees_where_the_cable_is_pressed_and_the_pressure_has_bounds():
    """Root force of the means of the starts within 1 %, or within what the starts' scatter leaves with 1e-4.

    Where weak cables are pulled shorter steps are needed for that than were stored (docs/simulation/return.md).
    """
    rows = 0
    for number in contested(TABLE):
        pressed = pressed_scene(number)
        if pressed.sliding_tensions()[1] < 0.0 and pressed.over_euler() <= BEYOND:
            rows += 1
            fast, slow = (members(TABLE, setting, "tension_mean_n").loc[number] for setting in (COARSE, IMPLICIT))
            scatter = np.hypot(fast.std(), slow.std()) / np.sqrt(MEMBERS)
            # two means of three starts each: Student's t with 4 degrees of freedom leaves 13 standard errors with 1e-4
            assert abs(fast.mean() - slow.mean()) <= max(0.01 * abs(slow.mean()), 13.0 * scatter)
    assert rows >= 4


def test_the_named_limits_hold_drawn_back():
    assert sorted(map(tuple, MAP[list(returns.KEYS)].to_numpy())) == sorted(returns.cells())
    held = MAP["diverged_at_s"].isna()
    assert held[MAP["ratio"] <= 1.0].all()
    assert held[MAP["method"] == "implicit"].all()


@pytest.mark.processor
@pytest.mark.parametrize("method", ["newmark", "imex", "explicit"])
def test_a_cell_of_the_return_is_repeated(method):
    assert np.isnan(returns.run_return(method, 1e5, 10.0, 0.3, 1.0)["diverged_at_s"])


def test_insertions_that_were_lost_end_with_the_cable_on_the_walls():
    on = INSERTIONS["cable"].astype(bool)
    assert not INSERTIONS.loc[on, "diverged"].astype(bool).any()
    assert INSERTIONS.loc[~on, "diverged"].astype(bool).any()
    units = lost.diverged_episodes(FOLDER.parent / "any-probe" / "episodes.csv")
    weak = INSERTIONS[on & (INSERTIONS["set"] == "any probe")][["policy", "context", "seed"]]
    assert sorted(weak.itertuples(index=False, name=None)) == sorted(units)
