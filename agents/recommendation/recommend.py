"""From a plant to its schedule: searched over what is known, simulated on tubes that the search did not see."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from agents.calibration.response import Response
from agents.evaluation.report import evaluate, plan_of
from agents.policies.catalogue import name_and_spec
from agents.policies.domain import OutsideDomain
from agents.policies.places import Place, place_of
from agents.processes.workers import HERE, Workers
from agents.recommendation.expectation import beyond
from agents.recommendation.search import Optimum, recommended, recommended_law
from agents.records.provenance import provenance, write_atomically, write_json
from probe_env import Plant

NAME: Final = "recommended"
LAW: Final = "recommended-law"
OURS: Final = ("best-schedule", "tension-scheduled")
"""What it is compared with besides the user's own."""


@dataclass(frozen=True)
class Confirmation:
    """How a recommendation is confirmed.

    Attributes:
        folder: of the episodes and the page.
        own: schedules of one's own to compare with, as ``evaluate`` takes them.
        limit: tubes that are simulated; 0: all.
        fidelity: of that.
    """

    folder: Path
    own: tuple[str, ...] = ()
    limit: int = 24
    fidelity: str = "standard"


def recommend(
    plant: Plant | None,
    output: Path,
    confirmation: Confirmation | None,
    response: Response,
    law: Path | None = None,
    workers: Workers = HERE,
) -> Optimum:
    """Search, write the schedule and how it was found beside it, simulate it against others, print.

    Args:
        plant: the tubes and what is known of them; None: table 2's in the shipped lists.
        output: the schedule (.csv); NAME.json beside it says how it was found.
        confirmation: against what, on how many tubes; None: it is not simulated.
        response: what is felt.
        law: file (.json) of the feedback law, where one is wanted.
        workers: of the simulation.

    Raises:
        ValueError: the plant, or a schedule of one's own, is not valid; nothing was written.
    """
    seen = place_of(plant, "train")
    unseen = place_of(plant, "test", confirmation.limit) if confirmation else seen
    for text in beyond(seen.contexts, response, seen.config):
        warnings.warn(f"recommended beyond what the response was learnt from: {text}", OutsideDomain, stacklevel=2)
    specs = (*(confirmation.own if confirmation else ()), *OURS)
    if seen.config.returns:
        print(
            f"{output.stem} is for the way in, and drawn back as fast as the device can;"
            " probe-env study best-round-trip searches feed and air of both ways"
        )
    if confirmation:
        with warnings.catch_warnings():  # what cannot be compared is refused before the search; warnings come with it
            warnings.simplefilter("ignore")
            plan_of(specs, unseen, 1, confirmation.fidelity)
    recommendation = recommended(seen.contexts, response, seen.config)
    write_atomically(output, recommendation.schedule.to_csv())
    write_json(output.with_suffix(".json"), _record(recommendation, plant, seen) | provenance())
    specs = (f"{NAME}={output}", *specs)
    if law:
        feedback = recommended_law(seen.contexts, response, seen.config)
        write_atomically(law, feedback.model_dump_json(indent=1))
        specs = (specs[0], f"{LAW}={law}", *specs[1:])
    print(
        f"{output}: expected reward {recommendation.reward:.1f} over {len(seen.contexts)} draws of what is known,"
        f" root tension at least {recommendation.tension:.2g} N in 95 % of them"
    )
    if confirmation:
        print(f"simulated on {len(unseen.contexts)} other draws at {confirmation.fidelity}:")
        _confirm(specs, unseen, confirmation, workers)
    return recommendation


def _confirm(specs: tuple[str, ...], place: Place, confirmation: Confirmation, workers: Workers) -> pd.DataFrame:
    plan = plan_of(specs, place, 1, confirmation.fidelity)
    own = [name_and_spec(spec)[0] for spec in confirmation.own] or [NAME]  # what the page's first line judges
    return evaluate(plan, confirmation.folder, against=NAME, workers=workers, own=own)


def _record(recommendation: Optimum, plant: Plant | None, place: Place) -> dict[str, Any]:
    return {
        "tube": plant.model_dump(mode="json", exclude={"posterior"}) if plant else None,
        "calibrated": plant is not None and plant.posterior is not None,
        "draws": len(place.contexts),
        "expected_reward": recommendation.reward,
        "least_root_tension_n": recommendation.tension,
    }
