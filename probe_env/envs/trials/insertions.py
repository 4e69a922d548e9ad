"""Whole insertions of probes under policies, gathered by metre of the sensor's position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import FAILURES, TaskConfig, drive_counts
from probe_env.envs.trials.candidates import FOUND_KPIS, LEAST_SNR, SENSOR_START, Candidate, Trial, seeds_of, stretch_of
from probe_env.envs.trials.players import periods_of
from probe_env.fidelity import Fidelity
from probe_env.schedule import Schedule

SUMS: Final = ("travel", "seconds", "air", "square", "noise", "tension", "periods")


def try_insertions(
    candidates: Sequence[Candidate],
    config: TaskConfig,
    fidelity: Fidelity | str = "standard",
    threads: int | None = None,
) -> Trial:
    """N whole insertions side by side, gathered by metre of the sensor's position; arguments as ``try_sections``.

    Raises:
        ValueError: a feed that is no policy with SB3's ``predict``.
    """
    policies = []
    for candidate in candidates:
        if isinstance(candidate.feed, Schedule):
            raise ValueError("feed: a whole insertion is fed by a policy; make one of the schedule")
        policies.append(candidate.feed)
    count, stretch = len(candidates), stretch_of(config)
    episodes = Episodes(count, config, threads=threads, may_stand=True, fidelity=fidelity)
    options = {
        k: {"context": candidate.context, "probe": candidate.design.built.model_dump()}
        for k, candidate in enumerate(candidates)
    }
    rngs = {k: np.random.default_rng(seed) for k, seed in enumerate(seeds_of(candidates))}
    observation, _ = episodes.reset(range(count), rngs, options)
    places = int(np.ceil(stretch.span))
    sums = {name: np.zeros((count, places)) for name in SUMS}
    failed = {name: np.zeros(count, dtype=bool) for name in FAILURES}
    guides = np.array([candidate.design.built.guide_length for candidate in candidates])
    inspected, blown = np.zeros(count), np.zeros(count)
    for step, active in periods_of(episodes, policies, observation):
        before, inspected = inspected, np.array([tally.inspected for tally in episodes.tally])
        blown_before, blown = blown, np.array([tally.air for tally in episodes.tally])
        for k in np.flatnonzero(active).tolist():
            info = step.infos[k]
            for name, flags in failed.items():
                flags[k] |= info[name]
            sensor = info["inserted_length"] - guides[k]
            place = min(int(np.floor(sensor - SENSOR_START - 1e-6)), places - 1)
            if place >= 0 and sensor <= stretch.end + 0.5 * config.period * info["feed_speed"] and not info["diverged"]:
                travel = info["inspected_length"] - before[k]
                sums["travel"][k, place] += travel
                sums["seconds"][k, place] += config.period
                sums["air"][k, place] += blown[k] - blown_before[k]
                sums["square"][k, place] += travel * info["radial_rms_m"] ** 2
                sums["noise"][k, place] += travel / max(info["snr"], LEAST_SNR) ** 2
                sums["tension"][k, place] += info["tension_mean_n"]
                sums["periods"][k, place] += 1.0
    trial = _gathered(sums, failed, guides, inspected, config)
    return replace(trial, detection=_detection(episodes, config.scene.tube.helix_length, guides))


def _detection(episodes: Episodes, tube_length: float, guides: FloatArray) -> dict[str, FloatArray]:
    """What would be found where a probe gets to if nothing ends it: what it misses by its guide is not charged here.

    Args:
        episodes: that have ended.
        tube_length: of the helix [m].
        guides: (N,) lengths of the guides [m].
    """
    reach = tube_length - guides - SENSOR_START
    kpis = [
        t.detection.kpis(max(t.inspected, float(own)), tube_length)
        for t, own in zip(episodes.tally, reach, strict=True)
    ]
    return {name: np.array([row[name] for row in kpis]) for name in FOUND_KPIS}


def _gathered(
    sums: Mapping[str, FloatArray],
    failed: Mapping[str, BoolArray],
    guides: FloatArray,
    inspected: FloatArray,
    config: TaskConfig,
) -> Trial:
    span, heard = stretch_of(config).span, config.vibration_measure == "snr"
    travel, seconds = np.maximum(sums["travel"], 1e-12), np.maximum(sums["seconds"], 1e-12)
    seen = sums["periods"] > 0.0
    metres = SENSOR_START + np.arange(travel.shape[1]) + 1.0
    deep = seen & drive_counts(config, metres + guides[:, None])
    # the metres of a whole insertion add up to the span but for a part of a period at each end
    widths = np.where(seen, sums["travel"], 0.0)
    complete = widths.sum(axis=1, keepdims=True) > span - 1.0
    widths = np.where(complete, widths * span / np.maximum(widths.sum(axis=1, keepdims=True), 1e-12), widths)
    return Trial(
        widths,
        np.where(seen, travel / seconds, 0.0),
        np.where(seen, sums["air"] / seconds, 0.0),
        np.sqrt(np.where(seen, sums["square"] / travel, 0.0)),
        sums["tension"] / np.maximum(sums["periods"], 1.0),
        deep,
        failed,
        inspected,
        np.sqrt(np.where(seen, sums["noise"] / travel, 0.0)) if heard else None,
    )
