"""Whole insertions of probes under policies, gathered by metre of the sensor's position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probe_env.envs.episodes import Episodes
from probe_env.envs.task import FAILURES, TaskConfig, drive_counts
from probe_env.envs.trials.candidates import FOUND_KPIS, LEAST_SNR, SENSOR_START, Candidate, Trial, seeds_of, stretch_of
from probe_env.envs.trials.players import periods_of
from probe_env.fidelity import Fidelity
from probe_env.schedule import Schedule


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
    episodes = Episodes(count, config, threads=threads, allow_standstill=True, fidelity=fidelity)
    designs = [candidate.design.built for candidate in candidates]
    options = {k: {"context": c.context, "probe": designs[k].model_dump()} for k, c in enumerate(candidates)}
    rngs = {k: np.random.default_rng(seed) for k, seed in enumerate(seeds_of(candidates))}
    observation, _ = episodes.reset(range(count), rngs, options)
    places = int(np.ceil(stretch.span))
    names = ("travel", "seconds", "air", "square", "noise", "tension", "periods")
    sums = {name: np.zeros((count, places)) for name in names}
    failed = {name: np.zeros(count, dtype=bool) for name in FAILURES}
    guides = np.array([design.guide_length for design in designs])
    inspected, blown = np.zeros(count), np.zeros(count)
    for step, active in periods_of(episodes, policies, observation):
        before, inspected = inspected, np.array([metrics.inspected for metrics in episodes.scorer.metrics])
        blown_before, blown = blown, np.array([metrics.air for metrics in episodes.scorer.metrics])
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
    travel, seconds = np.maximum(sums["travel"], 1e-12), np.maximum(sums["seconds"], 1e-12)
    seen = sums["periods"] > 0.0
    # the metres of a whole insertion add up to the span but for a part of a period at each end
    widths = np.where(seen, sums["travel"], 0.0)
    covered = widths.sum(axis=1, keepdims=True)
    widths = np.where(covered > stretch.span - 1.0, widths * stretch.span / np.maximum(covered, 1e-12), widths)
    # what a probe misses by its guide is not charged to what it finds
    tube = config.scene.tube.helix_length
    reach = (tube - guides - SENSOR_START).tolist()
    pairs = zip(episodes.scorer.metrics, reach, strict=True)
    found = [metrics.detection.kpis(max(metrics.inspected, own), tube) for metrics, own in pairs]
    return Trial(
        widths=widths,
        feed_speed=np.where(seen, travel / seconds, 0.0),
        air_supply_rate=np.where(seen, sums["air"] / seconds, 0.0),
        radial_rms=np.sqrt(np.where(seen, sums["square"] / travel, 0.0)),
        root_tension=sums["tension"] / np.maximum(sums["periods"], 1.0),
        deep=seen & drive_counts(config, SENSOR_START + np.arange(places) + 1.0 + guides[:, None]),
        failed=failed,
        inspected=inspected,
        noise=np.sqrt(np.where(seen, sums["noise"] / travel, 0.0)) if config.vibration_measure == "snr" else None,
        detection={name: np.array([row[name] for row in found]) for name in FOUND_KPIS},
    )
