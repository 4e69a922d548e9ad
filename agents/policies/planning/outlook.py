"""What feed and air would come to: copies of running probes go on for some periods, judged by the task's own rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from probe_env import Scene
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import (
    MEASURES,
    Outcome,
    air_used,
    capped_square,
    ending,
    reward_terms,
    slack,
    slack_in_a_row,
    travel,
)
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD


class Outlook(NamedTuple):
    """What (n, c) copies came to.

    Attributes:
        reward: of the periods that were tried.
        inserted: length at their end [m].
        over: whether the episode ended in them, or hangs slack at their end: then nothing comes after.
    """

    reward: FloatArray
    inserted: FloatArray
    over: BoolArray


class Estimate(NamedTuple):
    """What a planner takes for the truth.

    Attributes:
        blur: standard deviation of its knowledge of where the nodes are, radially [m].
        scenes: of probes whose tube it only estimates; others are in their own.
    """

    blur: float = 0.0
    scenes: Mapping[int, Scene] | None = None


def looked_ahead(
    episodes: Episodes, which: Sequence[int], tried: FloatArray, periods: int, estimate: Estimate, entropy: list[int]
) -> Outlook:
    """Try feed and air on copies of running probes; the episodes themselves stay as they are.

    Args:
        episodes: that are running.
        which: (n,) of them.
        tried: (n, c, 2) feed speeds [m/s] and air supplies [m3/s], held throughout.
        periods: control periods to try.
        estimate: what is known of state and tube.
        entropy: of the generator of what is not known.

    Raises:
        ValueError: the task's vibration measure is one that only episodes hear, or the probe is drawn back, too.
    """
    config = episodes.config
    name = MEASURES[config.vibration_measure][0]
    if config.vibration_measure == "snr" or config.returns:
        raise ValueError(
            f"vibration_measure = {config.vibration_measure!r}, passes = {config.passes!r}: a planner looks ahead for"
            " displacement, velocity or acceleration, on the way in"
        )
    count = tried.shape[1]
    copies = episodes.batch.branch(np.repeat(which, count).tolist(), estimate.scenes)
    for simulator in copies.simulators:
        simulator.feed_length()  # a look ahead is in time-lapse throughout
    blur_states(copies, estimate.blur, entropy)
    feed, air = tried[..., 0].ravel(), tried[..., 1].ravel()
    length = np.array([s.scene.tube.helix_length for s in copies.simulators])
    hung = np.repeat([episodes.tally[k].slack_periods for k in which], count)
    time = np.repeat([episodes.tally[k].time for k in which], count)
    change = config.actions(feed, air) - np.repeat(episodes.actions[list(which)].astype(float), count, axis=0)
    reward, left = np.zeros(len(feed)), np.ones(len(feed), dtype=bool)
    dynamic = config.period / episodes.fidelity.time_lapse
    for _ in range(periods):
        before, air_before = inserted_of(copies), np.array([s.air_supply_rate for s in copies.simulators])
        window = copies.advance(feed, air, dynamic, SAMPLE_PERIOD, left)
        good, after = left & ~window.diverged, inserted_of(copies)
        moved = np.where(good, travel(config, before, after, window.feed_speed), 0.0)
        squares = capped_square(config, window.statistics[name] / config.limit)
        time = time + config.period
        hung = slack_in_a_row(hung, slack(config, window.statistics["tension_mean_n"], after) & good)
        end = ending(config, after, length, hung, time, left, window.diverged)
        over = end.over
        used = np.where(good, air_used(config, air_before, window.air_supply_rate), 0.0)
        ahead = np.where(over & config.growing, length - np.where(good, after, before), 0.0)
        outcome = Outcome(moved, moved * squares, np.full(len(feed), config.period), used, ahead, end.diverged)
        reward += np.where(left, sum(reward_terms(config, outcome, change).values()), 0.0)
        left, change = left & ~over, np.zeros_like(change)
    inserted = inserted_of(copies)
    hanging = left & (hung > 0)  # drive that is about to be lost is lost: the map does not know of it
    lost = Outcome(*(np.zeros(len(feed)),) * 4, np.where(hanging, length - inserted, 0.0), np.zeros(len(feed), bool))
    reward += sum(reward_terms(config, lost).values())
    shape = tried.shape[:2]
    return Outlook(reward.reshape(shape), inserted.reshape(shape), (~left | hanging).reshape(shape))


def blur_states(copies: SimulatorBatch, blur: float, entropy: list[int]) -> None:
    """Move the nodes of copies radially by what is not known of them [m], all copies of a probe alike."""
    if blur <= 0.0:
        return
    for simulator in copies.simulators:
        noise = np.random.default_rng([*entropy, simulator.steps_done]).normal(size=simulator.chain.node_count)
        simulator.displace(blur * noise[: simulator.root])


def inserted_of(copies: SimulatorBatch) -> FloatArray:
    """(N,) cable in the helix, not more than it is long [m]."""
    return np.array([s.length_in_helix for s in copies.simulators])
