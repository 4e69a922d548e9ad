"""Whether noise is called as seldom as the threshold promises: counted behind the filter, where there is no flaw.

A threshold is raised by what an episode's meter hears of the motion: a quarter of every second, over the spectrum of
that second. Calls are counted on whole traces, the square of the motion in them included.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pydantic import FiniteFloat
from tqdm import tqdm

from agents.detection.passage import insert
from agents.detection.promise import DRAWS, FIELDS, HEADER, cells, summarise, tally_of
from agents.detection.stretches import threshold_of_all
from agents.policies.catalogue import named_policies
from agents.policies.places import Place
from agents.processes.workers import Workers
from agents.records.code_hash import code_hash
from agents.records.journal import Journal
from agents.records.models import Key, Stored
from agents.records.provenance import commit, provenance, write_atomically, write_json
from agents.rollouts.plan import Plan
from agents.terminal.tables import print_table
from agents.terminal.work import Work, announce
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.channels import Passage, along, calls, channels, filtered
from probe_env.inspection.detection import threshold
from probe_env.inspection.sensor import Sensor

POLICIES: Final = ("slow", "best-constant", "best-schedule", "plc-law", "tension-scheduled", "adaptive")
CODE: Final = ("agents.detection.false_calls:count_calls",)


class Count(Stored):
    """A line of ``counts.jsonl``: calls of one insertion, and what its threshold and curve follow from."""

    key: Key
    commit: str
    diverged: bool = False
    heights: list[FiniteFloat]
    """Of the calls over the threshold for Gaussian noise, below which none is, of all draws [deviations]."""
    heard: dict[str, list[float]]
    """Fields of its ``DetectionTally``."""
    threshold_of_all: float = math.nan
    """See ``stretches.threshold_of_all`` [deviations]."""


def heights(
    sensor: Sensor, passage: Passage, bore: float, z: float, draws: int, rng: np.random.Generator
) -> list[float]:
    """Of all calls over z deviations in a tube without a flaw, in so many draws of the electronics."""
    above: list[float] = []
    for _ in range(draws):
        voltages = channels(sensor, passage, bore, (), np.zeros(0), rng)
        values = filtered(sensor, passage, along(sensor, voltages))
        places = calls(values, passage.place, z, sensor.flaw_width)
        above += values[np.searchsorted(passage.place, places)].tolist()
    return above


def count_calls(plan: Plan, unit: tuple[str, int, int]) -> dict[str, Any]:
    """Play an episode of a plan with every sample kept, and count: fields of ``Count``."""
    name, k, seed = unit
    config, tube = plan.config, plan.config.scene.tube
    try:
        run = insert(plan.policies[name], config, plan.contexts[k], plan.fidelity, (seed, k), progress=False)
    except RuntimeError:
        return {"diverged": True, "heights": [], "heard": {}}
    rng, least = np.random.default_rng([seed, k, 1]), threshold(config.sensor, tube.helix_length)
    return {
        "heights": heights(config.sensor, run.passage, tube.inner_diameter, least, DRAWS, rng),
        "heard": {field: list(map(float, getattr(run.tally, field))) for field in FIELDS},
        "threshold_of_all": threshold_of_all(config.sensor, run.passage.radial, run.passage.feed, tube.helix_length),
    }


def run_false_calls(names: Sequence[str], place: Place, fidelity: str, output: Path, workers: Workers) -> pd.DataFrame:
    """Insertions of policies in all tubes, stored one by one; a row a policy: calls promised and counted, depths.

    Raises:
        ValueError: a policy or a fidelity is not known, or has time-lapse, which leaves metres out, or the task is of
            both ways; nothing was run.
        RuntimeError: all insertions of a policy diverged; what was stored stays.
    """
    config = place.config.all_shown
    if config.passes != "in":
        raise ValueError(f"task.passes = {config.passes!r}: false calls are counted on the way in")
    settings = resolve_fidelity(fidelity, config.scene)
    if settings.time_lapse != 1.0:
        raise ValueError(f"fidelity.time_lapse = {settings.time_lapse:g} leaves out metres in which calls are counted")
    plan = Plan(named_policies(names, config, place.vibration), place.contexts, config=config, fidelity=settings)
    keys, journal = {unit: _key(plan, unit) for unit in plan.units()}, Journal(output / "counts.jsonl", Count)
    announce(Work("insertion", len(keys), lambda: len(set(keys.values()) & journal.read().keys()), output))
    missing = [unit for unit, key in keys.items() if key not in journal.read()]
    if missing:
        with journal.appending() as append, tqdm(total=len(missing), desc="false calls", unit="insertion") as bar:
            for unit, counted in workers.map(partial(count_calls, plan), missing):
                append(json.dumps({"key": keys[unit], "commit": commit()} | counted) + "\n")
                bar.update()
    done = journal.read()
    kept = {unit: done[key] for unit, key in keys.items() if not done[key]["diverged"]}
    counts = pd.DataFrame([_row(plan, unit, counted) for unit, counted in kept.items()])
    of_policy = {name: [counted for unit, counted in kept.items() if unit[0] == name] for name in plan.policies}
    summary = summarise(config, of_policy)
    write_atomically(output / "counts.csv", counts.to_csv(index=False, float_format="%.5g"))
    write_atomically(output / "false-calls.csv", summary.to_csv(index=False, float_format="%.5g"))
    record = {"fidelity": settings.model_dump(), "tubes": len(place.contexts), "draws": DRAWS}
    record |= {"diverged": len(keys) - len(kept)}
    write_json(output / "provenance.json", provenance(commits=list(counts["commit"])) | record)
    print_table(f"Calls where there is no flaw, {len(place.contexts)} tubes", HEADER, cells(summary), left=1)
    if len(kept) < len(keys):
        print(f"{len(keys) - len(kept)} of {len(keys)} insertions diverged and are left out")
    return summary


def _key(plan: Plan, unit: tuple[str, int, int]) -> str:
    parts = [plan.setting(), plan.key(unit), DRAWS, code_hash(CODE, plan.fidelity.method)]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def _row(plan: Plan, unit: tuple[str, int, int], counted: Mapping[str, Any]) -> dict[str, Any]:
    """An insertion: its threshold, that of all of the motion, and how many calls a draw exceed each."""
    name, k, seed = unit
    z = tally_of(plan.config.sensor, counted["heard"]).threshold(plan.config.scene.tube.helix_length)
    above, of_all = np.array(counted["heights"]), counted["threshold_of_all"]
    return {
        "policy": name, "context": k, "seed": seed, "call_threshold": z,
        "calls": float((above > z).sum()) / DRAWS, "threshold_of_all": of_all,
        "calls_of_all": float((above > of_all).sum()) / DRAWS,
        "inspected_m": sum(counted["heard"]["lengths"]), "commit": counted["commit"],
    }  # fmt: skip
