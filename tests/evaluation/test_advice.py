"""Which policy is advised: hours of all passes within the limits of the plant, and what others do better."""

import pandas as pd
import pytest
from scipy.stats import norm

from probe_agents.evaluation.advice import choose, compare_passes
from probe_agents.evaluation.statistics import broken_limits, bundle_table, ranking, with_goal
from probe_env.envs.plants import Bundle
from probe_env.envs.task.config import TaskConfig
from probe_env.inspection.detection import threshold
from probe_env.inspection.metrics import POD_NAMES

BUNDLE = Bundle(tubes=36, setup_time=60.0, withdrawal_time=40.0)
TASK = TaskConfig(instrument={"highest_a90": 20.0})


def episodes(speeding=0.0, a90=15.0):
    """Four tubes: "slow" takes 600 s; "clean" 500 s; "loud" 400 s, and every second tube is to be repeated."""
    columns = ("policy", "inspection_time_s", "reward", "repeated", "length_too_fast_m", "a90_percent_wall")
    slow, loud = ("slow", 600.0, 1.0, 0, 0.0, 10.0), ("loud", 400.0, 5.0, 2, 0.0, 12.0)
    policies = pd.DataFrame([slow, loud, ("clean", 500.0, 3.0, 0, speeding, a90)], columns=columns)
    table = policies.merge(pd.DataFrame({"context": range(4), "seed": 0}), how="cross")
    table = table.assign(friction=0.05 + 0.05 * table["context"], helix_diameter=1.6)
    return table.assign(length_to_repeat_m=(table["context"] < table["repeated"]).astype(float))


def test_policies_are_ranked_by_all_hours_of_the_bundle():
    """With 100 s of setup and withdrawal 36 tubes take 7 h, 5 h and half of them once more, and 6 h."""
    table, hours = with_goal(episodes(), TASK, BUNDLE), pytest.approx({"slow": 7.0, "loud": 7.5, "clean": 6.0})
    assert table.groupby("policy")["total_hours"].mean().to_dict() == hours
    assert bundle_table(table, BUNDLE).set_index("policy")["total_hours"].to_dict() == hours
    assert ranking(table) == ["clean", "slow", "loud"]
    assert ranking(with_goal(episodes(), TASK, None)) == ["clean", "slow", "loud"]  # 500, 600, 600 s
    assert ranking(with_goal(episodes(), TaskConfig(), None)) == ["loud", "clean", "slow"]  # by reward


def test_policies_outside_a_limit_come_last():
    for changes, problem in (({"speeding": 1.0}, "too fast"), ({"a90": 21.0}, "a90 above 20 %")):
        outside = with_goal(episodes(**changes), TASK, BUNDLE)
        assert ranking(outside) == ["slow", "loud", "clean"]
        assert broken_limits(outside, "clean") == problem
        assert choose(outside, ())[0] == "slow"
    again = with_goal(episodes().assign(length_to_repeat_m=1.0), TASK, BUNDLE)
    assert broken_limits(again, "slow") == "second pass in most tubes"
    assert choose(again, ())[1].startswith("no schedule is within the limits (second pass in most tubes); of all")


def test_choice_names_what_other_policies_do_better():
    """Hours of two tubes of "loud" are 5 and of two 10: four differences of -1 and 4, with an interval."""
    _, sentence, (_, *rows) = choose(with_goal(episodes(), TASK, BUNDLE), ())
    assert sentence == (
        "best by hours of all passes is clean, by a90 slow, by reward loud;"
        " by hours of all passes not clearly better than loud"
    )
    assert rows[0] == ("hours of all passes", "clean", "6", "15", "3")
    assert (*rows[2][:2], *rows[2][3:]) == ("reward", "loud", "-3", "+2")
    assert rows[2][2].startswith("+1.5 [-1, ")
    assert rows[1] == ("a90", "slow", "+1", "-5", "-2")
    assert choose(with_goal(episodes(), TASK, BUNDLE), {"clean"})[0] == "slow"


def test_passes_with_a_probe_that_is_still_on_the_way_out():
    """A 20 % groove has S/N 7.5 at 0.2 m/s, sqrt(2) less at 0.4: a90 is 20 % (z + 1.28) / S/N, with z = 4.59 in 60 m.

    36 tubes take (60 + 500 + 40) s on the way in, and (60 + 55 m / 0.4 m/s + 60 m / 0.2 m/s) s on the way out.
    """
    task = TaskConfig(instrument={"highest_speed": 0.2})
    blind = dict.fromkeys(POD_NAMES, 0.0)
    table = with_goal(episodes().assign(**blind), task, BUNDLE)
    header, way_in, out, both = compare_passes(table, "clean", task, BUNDLE)
    assert header[2] == "hours for 36 tubes"
    assert way_in == ("on the way in, clean", "600", "6", "15")
    a90 = 20.0 * (threshold(task.sensor, 60.0) + norm.ppf(0.9)) / 7.5
    assert out == ("on the way out, \u03bcl/r up to 15", "498", "4.97", f"{a90:.3g}")
    assert both[:3] == ("on both ways", "860", "8.6")
    assert a90 < float(both[3]) < 1.05 * a90  # half of the false calls, and an insertion that finds nothing
    fast = TaskConfig(instrument={})
    assert float(compare_passes(with_goal(table, fast, BUNDLE), "clean", fast, BUNDLE)[2][3]) == pytest.approx(
        2.0**0.5 * a90, rel=5e-3
    )
    assert compare_passes(with_goal(episodes(), task, None), "clean", task, None)[2][1] == "438"  # 55 / 0.4 + 300 s
    assert compare_passes(table, "clean", TaskConfig(passes="both"), BUNDLE) == ()
    assert compare_passes(episodes(), "clean", TaskConfig(), None) == ()
