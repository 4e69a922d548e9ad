"""A probe to be tried, and what probes did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import Design
from probe_env.envs.contexts import Context
from probe_env.envs.trials.players import Controller
from probe_env.schedule import Schedule

FOUND_KPIS: Final = ("a50_percent_wall", "a90_percent_wall", "length_with_snr_over_3_m", "noise_peak_to_peak_v")
"""What whole insertions are told by of what would be found, see ``inspection.tally``."""
LEAST_SNR: Final = 1e-3
"""What no signal at all counts as, so that its inverse is finite."""


@dataclass(frozen=True)
class Candidate:
    """A probe that is tried in a tube.

    Attributes:
        design: of the probe.
        context: the tube.
        feed: a schedule over inserted length, or for whole insertions a policy.
        seed: of the start's perturbation; default: its place among the candidates.
    """

    design: Design
    context: Context
    feed: Schedule | Controller
    seed: int | None = None


@dataclass(frozen=True)
class Trial:
    """What N probes did in p places; SI units.

    Attributes:
        widths: (N, p) length of tube that was inspected there; 0 where the probe did not get to.
        feed_speed, air_supply_rate: (N, p) fed and blown there.
        radial_rms, root_tension: (N, p).
        deep: (N, p) whether so much is inserted that lost drive counts.
        failed: (N,) whether it ended so, by each of ``FAILURES``.
        inspected: (N,) what the sensor saw to the end, where that was simulated.
        noise: (N, p) over the signal of a 20 % groove, where the task is judged by that.
        detection: (N,) of each of ``FOUND_KPIS``, over all that its guide lets a probe inspect; sections are
            too short to tell.
    """

    widths: FloatArray
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    radial_rms: FloatArray
    root_tension: FloatArray
    deep: BoolArray
    failed: Mapping[str, BoolArray]
    inspected: FloatArray | None = None
    noise: FloatArray | None = None
    detection: Mapping[str, FloatArray] = field(default_factory=dict)


def seeds_of(candidates: Sequence[Candidate]) -> list[int]:
    """Of the starts."""
    return [k if candidate.seed is None else int(candidate.seed) for k, candidate in enumerate(candidates)]
