"""Evaluation: policies x contexts x seeds on the native batch, resumable, into one table of KPIs per episode.

An episode depends on its policy, context and seed alone, not on what ran beside it, so an evaluation that was
interrupted goes on to the same table.
"""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.processes.workers import HERE, Workers
from agents.records import reading as stored
from agents.records.code_hash import class_hash, code_hash
from agents.records.columns import CARRIED, HEARD
from agents.records.models import Setting
from agents.records.provenance import commit, provenance, write_json
from agents.rollouts.folder import UNFINISHED, episodes_of, gathered, write_tables
from agents.rollouts.playing import Ended, Playing
from agents.terminal.work import Work, announce
from probe_env import Context, Fidelity
from probe_env.envs.episodes.starts import Probes
from probe_env.envs.task import SHOWN, TaskConfig, describe
from probe_env.envs.trials import Controller, Foresighted
from probe_env.envs.vibration_map import VibrationMap
from probe_env.fidelity import with_nodes

BATCH = 16
SHARED = ("fidelity", "code", "probes")
"""What all episodes of a table have in common, besides the task."""
CODE = (
    "probe_env.envs.episodes:Episodes.reset",
    "probe_env.envs.episodes:Episodes.step",
    "agents.rollouts.plan:per_metre",
)
"""What an episode depends on, besides its policy."""


class Policy(Controller, Protocol):
    """What evaluation needs: SB3's ``predict`` and a description that is equal for equal policies."""

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""


@dataclass(frozen=True)
class Plan:
    """What is evaluated: every policy on every context with every seed.

    ``probes``: "scene", or "random": context and seed draw a ``Design``, the same for every policy. ``fidelity`` gives
    way to nodes where the task's scene needs some, see ``fidelity.with_nodes``. ``vibration`` is the map of fidelity
    "surrogate"; default: the shipped one.
    """

    policies: Mapping[str, Policy]
    contexts: Sequence[Context]
    seeds: Sequence[int] = (0,)
    config: TaskConfig = field(default_factory=TaskConfig)
    fidelity: Fidelity = field(default_factory=Fidelity)
    probes: Probes = "scene"
    vibration: VibrationMap | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", with_nodes(self.fidelity, self.config.scene))

    def setting(self) -> dict[str, Any]:
        """What all episodes share: results with another setting do not belong in the same table."""
        return {
            **describe(self.config),
            "fidelity": self.fidelity.model_dump(),
            "code": code_hash(CODE, self.fidelity.method),
            "probes": self.probes,
        }

    def units(self) -> list[tuple[str, int, int]]:
        """Policy name, context number and seed of every episode."""
        return [(name, k, seed) for name in self.policies for seed in self.seeds for k in range(len(self.contexts))]

    def planned(self) -> list[tuple[str, str, int, int]]:
        """Key, policy name, context number and seed of every episode."""
        return [(self.key(unit), *unit) for unit in self.units()]

    def described(self) -> dict[str, Any]:
        """Its tubes and episodes, JSON-ready: what a folder is to hold."""
        return {"contexts": [context.model_dump() for context in self.contexts], "episodes": self.planned()}

    def policies_described(self) -> dict[str, Any]:
        """What its policies say of themselves, JSON-ready; of a hand that drives, at the end."""
        return {"policies": {name: policy.describe() for name, policy in self.policies.items()}}

    def key(self, unit: tuple[str, int, int]) -> str:
        """Identity of an episode: policy as described and written, context and seed."""
        name, k, seed = unit
        policy = self.policies[name]
        written = class_hash(type(policy), "decide" if isinstance(policy, Foresighted) else "predict")
        parts = [policy.describe(), written, self.contexts[k].model_dump(), k, seed]  # the place is in the seed
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


Source = Callable[[Plan, "deque[tuple[str, int, int]]"], Iterator[str]]
"""Plays episodes of a plan, of which it gives a line of JSON each, see ``lines_of``."""


def run_plan(
    plan: Plan,
    output: Path | None,
    batch: int = BATCH,
    progress: bool = True,
    threads: int | None = None,
    workers: Workers = HERE,
    source: Source | None = None,
) -> pd.DataFrame:
    """Run what is missing in ``output`` and return the table of all episodes of the plan.

    Every episode is appended to ``episodes.jsonl`` as it ends, also in a worker (on Ray when its portion ends); at the
    end ``episodes.csv`` and ``episodes.parquet`` (KPIs) and ``profile.parquet`` (per metre of inserted length) are
    written. Until then ``unfinished.json`` says what there is to be. Without an output nothing is read or written.
    With a ``source`` it plays what is missing, in place of this process or workers.

    Raises:
        ValueError: the folder holds episodes of another setting; nothing is changed.
    """
    if output is None:
        lines = _lines(plan, deque(plan.units()), batch, threads, workers)
        return gathered(plan.planned(), plan.contexts, {record["key"]: record for record in map(json.loads, lines)})[0]
    journal, done = episodes_of(output), stored_episodes(plan, output)
    units = {plan.key(unit): unit for unit in plan.units()}
    missing = deque(unit for key, unit in units.items() if key not in done)
    announce(Work("episode", len(units), lambda: len(units.keys() & journal.read().keys()), output), quiet=not progress)
    write_json(output / UNFINISHED, provenance() | plan.policies_described() | plan.described())
    if missing:
        write_json(output / "setting.json", plan.setting())
        with (
            journal.appending() as append,
            tqdm(total=len(missing), desc="evaluate", unit="episode", disable=not progress) as bar,
        ):
            for line in source(plan, missing) if source else _lines(plan, missing, batch, threads, workers):
                append(line)
                bar.update()
        done = journal.read()
    table, profile = gathered(plan.planned(), plan.contexts, done)
    write_tables(table, profile, output)
    write_json(output / "provenance.json", provenance(commits=table["commit"]) | plan.policies_described())
    (output / UNFINISHED).unlink(missing_ok=True)
    return table


def stored_episodes(plan: Plan, output: Path) -> dict[str, dict[str, Any]]:
    """Records of the episodes that a folder holds, by their keys.

    Raises:
        ValueError: they are of another setting than the plan's, or nobody knows of which; or a file is damaged.
    """
    path, journal = output / "setting.json", episodes_of(output)
    if path.exists():
        this = Setting.model_validate_json(json.dumps(plan.setting()))
        before, now = _shared(stored.read_json(path, Setting)), _shared(this)
        different = [name for name in now if before.get(name) != now[name]]
        if different:
            raise ValueError(
                f"{output} holds episodes of another setting ({', '.join(different)} differ): choose another folder"
            )
    elif journal.read():
        raise stored.FileError(path, "missing beside episodes.jsonl, so nobody knows their task: choose another folder")
    return journal.read()


def check_stored(plan: Plan, output: Path) -> None:
    """Raise as ``stored_episodes`` does, before work that comes first."""
    stored_episodes(plan, output)


def _shared(setting: Setting) -> dict[str, Any]:
    """What episodes must share: not what is observed, and fields newer than the results have their defaults."""
    return setting.task.model_dump(exclude=set(SHOWN)) | {name: getattr(setting, name) for name in SHARED}


def _lines(
    plan: Plan, missing: deque[tuple[str, int, int]], batch: int, threads: int | None, workers: Workers
) -> Iterator[str]:
    """A line of JSON for each episode, run here or by workers in portions of a batch."""
    if workers.here:
        yield from _run_units(plan, missing, batch, threads)
        return
    size, units = portion_size(len(missing), workers.jobs, batch), list(missing)
    portions = [units[begin : begin + size] for begin in range(0, len(units), size)]
    for _, line in workers.stream(partial(_portion, plan), portions):
        yield line


def portion_size(episodes: int, jobs: int, batch: int = BATCH) -> int:
    """Episodes that a worker does side by side: a whole batch, or fewer so that each has two portions at least."""
    return max(min(batch, episodes // (2 * jobs)), 1)


def _portion(plan: Plan, units: list[tuple[str, int, int]]) -> Iterator[str]:
    """What a worker does: some episodes side by side on one thread."""
    return _run_units(plan, deque(units), len(units), 1)


def _run_units(plan: Plan, missing: deque[tuple[str, int, int]], batch: int, threads: int | None) -> Iterator[str]:
    """Run episodes side by side, the next one starting wherever one ends; yields a line of JSON for each."""
    playing = Playing(plan, missing, batch, threads)
    while not playing.over:
        yield from lines_of(plan, playing.step())


def lines_of(plan: Plan, ended: Iterable[Ended]) -> Iterator[str]:
    """A line of JSON for each episode that has ended."""
    for episode in ended:
        yield _line(plan, episode.unit, episode.kpis, episode.profile, episode.probe)


def _line(
    plan: Plan,
    unit: tuple[str, int, int],
    kpis: dict[str, float],
    profile: list[tuple[float, ...]],
    probe: dict[str, float] | None,
) -> str:
    columns = {name: [float(f"{v:.5g}") for v in values] for name, values in per_metre(profile).items()}
    record = {"key": plan.key(unit), "unit": unit, "commit": commit(), "kpis": kpis, "profile": columns}
    return json.dumps(record | ({"probe": probe} if probe else {})) + "\n"


def per_metre(profile: list[tuple[float, ...]]) -> dict[str, np.ndarray]:
    """Periods (of ``CARRIED`` and ``HEARD``) gathered by metre of inserted length: means, but root mean square of rms.

    ``inserted_length`` is then the middle of the metre, ``time`` that of its last period.
    """
    names, squared = (*CARRIED, *HEARD), ["radial_rms_m", *HEARD]
    if not profile:
        return {name: np.zeros(0) for name in names}
    periods = pd.DataFrame(profile, columns=list(names))
    # the period that ends on a whole metre belongs to the metre before
    metre = np.ceil(periods["inserted_length"] - 1e-6) - 1.0
    groups = periods.assign(**{name: periods[name] ** 2 for name in squared}).groupby(metre)
    gathered = groups.mean()
    gathered[squared] **= 0.5
    gathered["time"] = groups["time"].max()
    gathered["inserted_length"] = gathered.index + 0.5
    return {name: gathered[name].to_numpy() for name in names}
