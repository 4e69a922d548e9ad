"""Actions and the ranges that they stand for, and periods without drive in a row."""

import numpy as np
import pytest
from probe_env.envs.episodes.kpis import Tally

from probe_env.envs.task import TaskConfig, action_in, action_of, share_between, share_of, slack_in_a_row, value_at

RANGE, OTHER = (0.02, 0.4), (0.05, 0.25)


def test_shares_and_values_are_each_other_s_inverse():
    values = np.linspace(*RANGE, 7)
    shares = share_between(values, RANGE)
    assert value_at(shares, RANGE) == pytest.approx(values, rel=1e-15)
    assert share_of(action_of(shares)) == pytest.approx(shares, abs=1e-15)
    assert (share_of(np.array([-1.5, 1.5])) == [0.0, 1.0]).all()


def test_an_action_asks_for_the_same_in_another_range_beyond_its_ends_too():
    actions = np.array([-1.0, -0.5, 0.0, 1.0])
    asked = TaskConfig(feed_speeds=RANGE).targets(np.column_stack([actions, actions]))[:, 0]
    translated = action_in(actions, RANGE, OTHER)
    assert value_at(0.5 * (translated + 1.0), OTHER) == pytest.approx(asked, rel=1e-14)
    assert translated[0] < -1.0
    assert translated[-1] > 1.0


def test_what_stands_still_in_one_task_stands_still_in_the_other():
    here, there = TaskConfig(feed_speeds=RANGE), TaskConfig(feed_speeds=OTHER)
    standing = action_in(np.array([float(here.standing)]), RANGE, OTHER)
    assert standing == pytest.approx(float(there.standing), abs=2.0**-22)  # both are float32


def test_periods_without_drive_are_counted_in_a_row():
    """Of many probes at once and of one; an event is counted when the row is as long as it may be, and once."""
    hangs = np.array([[1, 1, 0, 1, 1, 1, 1], [0, 1, 1, 1, 0, 0, 1]], dtype=bool)
    rows, tally, counts = np.zeros(2, dtype=int), Tally(), []
    for hanging in hangs.T:
        rows = slack_in_a_row(rows, hanging)
        tally.add_drive(bool(hanging[0]), patience=3)
        counts.append(rows.tolist())
        assert tally.slack_periods == rows[0]
        assert type(tally.slack_periods) is int
    assert np.array(counts).T.tolist() == [[1, 2, 0, 1, 2, 3, 4], [0, 1, 2, 3, 0, 0, 1]]
    assert tally.lost_drive_events == 1
