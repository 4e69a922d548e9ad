"""Logs in, what is known of the plant out: ``calibration.json``, pictures, and a verdict in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from agents.calibration.gauge import LIMIT, Gain, gain_of
from agents.calibration.inference import Case, Posterior, check_cases, sampled
from agents.calibration.metres import CHANNELS, metres_of
from agents.calibration.response import Response
from agents.calibration.sliding import Sliding, by_sliding
from agents.calibration.unknowns import UNKNOWNS, Prior, prior_of
from agents.logs.log import Log
from probe_env import Plant
from probe_env.arrays import FloatArray

LEVEL: Final = 0.90
"""Of the intervals."""
AT_EDGE: Final = 0.06, 0.5
"""A posterior of which half lies within so small a share of what was held possible leans against its edge."""


@dataclass(frozen=True)
class Recorded:
    """A log and the tube it was recorded in.

    Attributes:
        name: of the log.
        log: read and mended.
        tube: name of the tube; logs of one name share a friction.
        helix_diameter: of that tube [m].
    """

    name: str
    log: Log
    tube: str
    helix_diameter: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """What logs told.

    Attributes:
        prior: what was held possible.
        cases: the logs by metres.
        tubes: names.
        posterior: draws and misfit.
        sliding: by the tension alone, of each tube; None without one.
        beyond: what of each log lies beyond what the response was learnt from.
        limits: greatest misfit of each channel, and of all, that is held possible.
        gains: of each log how its gauge of tension seems to read; None without one.
    """

    prior: Prior
    cases: tuple[Case, ...]
    tubes: tuple[str, ...]
    posterior: Posterior
    sliding: tuple[Sliding | None, ...]
    beyond: tuple[tuple[str, ...], ...]
    limits: FloatArray
    gains: tuple[Gain | None, ...]

    def summary(self, name: str, tube: int | None = None) -> dict[str, float]:
        """Mean and 90 % interval of an unknown, of one tube or over all of them."""
        column = list(UNKNOWNS).index(name)
        draws = self.posterior.draws[:, :, column] if tube is None else self.posterior.draws[tube, :, column]
        low, high = np.quantile(draws, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
        return {"mean": float(draws.mean()), "low": float(low), "high": float(high)}

    @property
    def misfits(self) -> list[str]:
        """Why the model cannot have made these logs, one sentence each; none where it can."""
        reasons = []
        for case, misfit, gauge in zip(self.cases, self.posterior.misfit, self.gains, strict=True):
            if gauge and gauge.ratio > LIMIT:
                reasons.append(
                    f"{case.name}: root tension fits the rest and what was held possible only if the gauge reads"
                    f" {gauge.gain:.2f} times what it should (twice the log of the likelihoods' ratio is"
                    f" {gauge.ratio:.1f}, one log in thirty: {LIMIT:g})"
                )
            for k, name in enumerate((*CHANNELS, "all channels together")):
                if misfit[k] > self.limits[k]:
                    reasons.append(
                        f"{case.name}: {name.replace('_', ' ')} strays {np.sqrt(misfit[k]):.1f} times as far from the"
                        f" model as simulated logs do (one in a hundred: {np.sqrt(self.limits[k]):.1f})"
                    )
        return reasons

    @property
    def leaning(self) -> list[str]:
        """Unknowns that want to leave what was held possible, in words."""
        sentences = []
        width, share = AT_EDGE
        for column, name in enumerate(UNKNOWNS):
            if name in self.prior.known:
                continue
            low, high = self.prior.ranges[name]
            at = (self.posterior.draws[:, :, column] - low) / (high - low)
            for side, near in (("least", at < width), ("greatest", at > 1.0 - width)):
                if near.mean() > share:
                    sentences.append(f"{UNKNOWNS[name].text} leans against the {side} value held possible")
        return sentences

    @property
    def verdict(self) -> str:
        """In a sentence."""
        if self.misfits:
            return "misspecified: the model cannot have made these logs, whatever friction - do not use the figures"
        if self.leaning:
            return "doubtful: the logs are best explained at an edge of what was held possible"
        return "the logs are what the model gives with these figures"

    def to_json(self) -> dict[str, Any]:
        """``calibration.json``: what was found, draws, verdict."""
        draws = self.posterior.draws
        kept = np.arange(draws.shape[1])
        tube = kept % len(self.tubes)  # over all tubes: each in turn
        return {
            **{name: self.summary(name) | {"unit": UNKNOWNS[name].unit} for name in UNKNOWNS},
            "verdict": self.verdict,
            "misspecified": bool(self.misfits),
            "reasons": [*self.misfits, *self.leaning, *(text for texts in self.beyond for text in texts)],
            "tubes": {
                name: {
                    "friction": self.summary("friction", k),
                    "logs": [case.name for case in self.cases if case.tube == k],
                    "helix_diameter": next(c.scene.tube.helix_diameter for c in self.cases if c.tube == k),
                    "by_tension_alone": _sliding(self.sliding[k]),
                }
                for k, name in enumerate(self.tubes)
            },
            "held_possible": {name: list(range_) for name, range_ in self.prior.ranges.items()},
            "known": self.prior.known,
            "draws": {
                name: [float(f"{v:.6g}") for v in draws[tube, kept, column]]
                for column, name in enumerate(UNKNOWNS)
                if name not in self.prior.known
            },
        }


def calibrate(
    recorded: Sequence[Recorded], plant: Plant, response: Response, file: str = "tube", progress: bool = True
) -> Calibration:
    """What logs tell of friction, stiffness, drag and damping; the friction of each tube, the rest shared by all.

    Args:
        recorded: the logs.
        plant: where they were recorded; its helix diameter is that of each log.
        response: what is felt.
        file: of the plant, for errors.
        progress: whether a bar is shown.

    Raises:
        ValueError: a log tells too little, or a figure of the plant lies beyond what the response was learnt for.
    """
    prior = prior_of(plant, file)
    tubes = tuple(dict.fromkeys(entry.tube for entry in recorded))
    cases = []
    for entry in recorded:
        scene = plant.scene.model_copy(update={"tube": {"helix_diameter": entry.helix_diameter}})
        cases.append(Case(entry.name, tubes.index(entry.tube), scene, metres_of(entry.log)))
    check_cases(cases)
    beyond = tuple(tuple(f"{c.name}: {text}" for text in response.outside(c.metres, c.scene)) for c in cases)
    sliding = tuple(by_sliding([c for c in cases if c.tube == k], prior) for k in range(len(tubes)))
    posterior = sampled(response, cases, prior, progress=progress)
    gains = tuple(gain_of(posterior.likelihood, number, prior) for number in range(len(cases)))
    return Calibration(prior, tuple(cases), tubes, posterior, sliding, beyond, response.misfit, gains)


def _sliding(fit: Sliding | None) -> dict[str, dict[str, float]] | None:
    if fit is None:
        return None
    return {
        name: dict(zip(("mean", "low", "high"), getattr(fit, name), strict=True))
        for name in ("friction", "drag_coefficient")
    }
