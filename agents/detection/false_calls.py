"""Whether noise is called as seldom as the threshold promises: counted behind the filter, where there is no flaw.

A threshold is raised by what an episode's meter hears of the motion: a quarter of every second, over the spectrum of
that second. Calls are counted on whole traces, the square of the motion in them included, and the threshold is told at
which they would be as many as was promised.
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
from agents.policies.catalogue import named_policies
from agents.policies.places import Place
from agents.processes.workers import Workers
from agents.records.code_hash import code_hash
from agents.records.journal import Journal
from agents.records.models import Key, Stored
from agents.records.provenance import commit, provenance, write_atomically, write_json
from agents.rollouts.bootstrap import PERCENTILES, Interval
from agents.rollouts.bootstrap import redrawn as redrawn_places
from agents.rollouts.depths import a90_95
from agents.rollouts.plan import Plan
from agents.rollouts.statistics import mean_interval
from agents.terminal.tables import print_table
from agents.terminal.work import Work, announce
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.channels import Passage, along, calls, channels, filtered
from probe_env.inspection.detection import threshold
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import POD_NAMES, DetectionTally, curve

POLICIES: Final = ("slow", "best-constant", "best-schedule", "plc-law", "tension-scheduled", "adaptive")
DRAWS: Final = 40
"""Of the electronic noise over one and the same motion."""
FIELDS: Final = ("lengths", "snr", "shares", "peaks", "singles", "counts")
"""Of ``DetectionTally``."""
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
    }


def tally_of(sensor: Sensor, heard: Mapping[str, Sequence[float]]) -> DetectionTally:
    """The tally whose fields were stored."""
    lists = {name: list(values) for name, values in heard.items() if name != "counts"}
    return DetectionTally(sensor, **lists, counts=np.array(heard["counts"]))


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
    summary = summarise(plan, kept)
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
    """An insertion: its threshold and how many calls a draw exceed it."""
    name, k, seed = unit
    z = tally_of(plan.config.sensor, counted["heard"]).threshold(plan.config.scene.tube.helix_length)
    called = float((np.array(counted["heights"]) > z).sum()) / DRAWS
    return {
        "policy": name, "context": k, "seed": seed, "call_threshold": z, "calls": called,
        "inspected_m": sum(counted["heard"]["lengths"]), "commit": counted["commit"],
    }  # fmt: skip


def raised(above: Sequence[np.ndarray], promised: float, draws: int) -> float:
    """How much higher [deviations] all thresholds must be for the promised calls a tube; 0 where they are as few.

    Args:
        above: heights of each tube's calls over its own threshold.
        promised: calls a tube.
        draws: of which each tube's heights are.
    """
    ordered = np.sort(np.concatenate(above))[::-1]
    allowed = math.floor(promised * draws * len(above) + 1e-9)
    return max(float(ordered[allowed]), 0.0) if len(ordered) > allowed else 0.0


def summarise(plan: Plan, done: Mapping[tuple[str, int, int], Mapping[str, Any]]) -> pd.DataFrame:
    """A row a policy: calls a tube, promised and counted, the rise of the thresholds that keeps the promise, depths.

    Calls and rise have 95 % intervals over tubes: over few of them the rise hangs on a spike or two. Depths are those
    with the thresholds as they are, and risen, the ends of the rise's interval included.

    Raises:
        RuntimeError: there is no insertion of a policy.
    """
    sensor, length = plan.config.sensor, plan.config.scene.tube.helix_length
    rows = []
    for name in plan.policies:
        counted = [record for unit, record in done.items() if unit[0] == name]
        if not counted:
            raise RuntimeError(f"policy {name}: all insertions diverged")
        tallies = [tally_of(sensor, record["heard"]) for record in counted]
        z = np.array([tally.threshold(length) for tally in tallies])
        above = [np.array(record["heights"], dtype=float) - own for record, own in zip(counted, z, strict=True)]
        calls_of = mean_interval(np.array([(part > 0.0).sum() / DRAWS for part in above]))
        inspected = np.array([sum(tally.lengths) for tally in tallies])
        promised = sensor.false_calls * float(inspected.mean()) / length
        rise = raised(above, promised, DRAWS)
        redrawn = [raised([above[k] for k in drawn[0]], promised, DRAWS) for drawn in redrawn_places(len(above))]
        low, high = (float(value) for value in np.percentile(redrawn, PERCENTILES))
        depths = {end: _depths(tallies, z + more) for end, more in
                  {"": 0.0, "_risen": rise, "_risen_low": low, "_risen_high": high}.items()}  # fmt: skip
        rows.append(
            {
                "policy": name, "tubes": len(counted), "call_threshold": z.mean(), "gaussian_threshold":
                threshold(sensor, length), "promised": promised, "calls": calls_of.mean, "calls_low": calls_of.low,
                "calls_high": calls_of.high, "rise": rise,
                "rise_low": low, "rise_high": high,
                **{f"inspected_a90_95{end}_percent_wall": depth for end, depth in depths.items()},
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def _depths(tallies: Sequence[DetectionTally], z: np.ndarray) -> float:
    """a90/95 over the tubes with these thresholds, in what each inspected [% of the wall]."""
    rows = []
    for k, (tally, own) in enumerate(zip(tallies, z, strict=True)):
        mean = curve(np.array(tally.lengths), tally.pod(float(own)), sum(tally.lengths))
        rows.append({"policy": "", "context": k, "seed": 0} | dict(zip(POD_NAMES, mean, strict=True)))
    return a90_95(pd.DataFrame(rows), "")


DEPTH: Final = "inspected_a90_95_percent_wall"
DEPTH_OF: Final = {end: f"inspected_a90_95_{end}_percent_wall" for end in ("risen", "risen_low", "risen_high")}
HEADER: Final = (
    "policy", "mean threshold", "calls a tube promised", "counted", "rise that keeps the promise", "a90/95 [%]",
    "a90/95 with it [%]",
)  # fmt: skip


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a policy."""
    return [
        (
            str(row["policy"]), f"{row['call_threshold']:.2f}", f"{row['promised']:.2g}",
            f"{row['calls']:.2f} [{row['calls_low']:.2f}, {row['calls_high']:.2f}]",
            f"{row['rise']:.2f} [{row['rise_low']:.2f}, {row['rise_high']:.2f}]",
            f"{row[DEPTH]:.1f}",
            Interval(*(row[DEPTH_OF[end]] for end in ("risen", "risen_low", "risen_high"))).text(),
        )
        for row in summary.to_dict("records")
    ]  # fmt: skip
