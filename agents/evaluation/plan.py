"""Plays a plan: policies x contexts x seeds side by side, resumable, into one table of episodes.

An episode depends only on its policy, context and seed, so an interrupted evaluation continues to the same table.
"""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from agents.evaluation.folder import FILES, UNFINISHED, Setting, episodes_of, gathered, write_tables
from agents.evaluation.folder import Unit as Unit
from agents.evaluation.kpis import CARRIED, HEARD
from agents.evaluation.workers import HERE, Workers
from agents.policies.policy import Policy as Policy
from agents.records.manifest import commit, origin, write_json, write_manifest
from agents.records.models import read_json
from agents.terminal.work import Work, announce
from probe_env import Context, Fidelity
from probe_env.arrays import BoolArray
from probe_env.design import RANGES
from probe_env.envs.episodes import Step
from probe_env.envs.episodes.starts import Probes
from probe_env.envs.surrogate import make_episodes
from probe_env.envs.task import SHOWN, TaskConfig, describe
from probe_env.envs.trials import Players
from probe_env.envs.vibration_map import VibrationMap
from probe_env.files import FileError

BATCH: Final = 16
"""Episodes side by side."""
COLUMNS: Final = (*CARRIED, *HEARD)
"""Columns of a profile."""


@dataclass(frozen=True)
class Plan:
    """An evaluation: every policy on every context with every seed.

    Attributes:
        policies: by their names in tables.
        contexts: the tubes.
        seeds: of sensor noise and start.
        config: the task.
        fidelity: of the simulation, resolved for the scene (``fidelity.resolve_fidelity``).
        probes: "scene", or "random": context and seed draw a ``Design``, the same for every policy.
        vibration: map of fidelity "surrogate"; default: the shipped one.
    """

    policies: Mapping[str, Policy]
    contexts: Sequence[Context]
    seeds: Sequence[int] = (0,)
    config: TaskConfig = field(default_factory=TaskConfig)
    fidelity: Fidelity = field(default_factory=Fidelity)
    probes: Probes = "scene"
    vibration: VibrationMap | None = None

    def setting(self) -> dict[str, Any]:
        """What all episodes of a folder share, JSON-ready."""
        code = {"version": version("probe-env"), "commit": commit()}
        return {**describe(self.config), "fidelity": self.fidelity.model_dump(), "probes": self.probes, **code}

    def units(self) -> list[Unit]:
        """Policy name, context number and seed of every episode."""
        return [(name, k, seed) for name in self.policies for seed in self.seeds for k in range(len(self.contexts))]

    def planned(self) -> list[tuple[str, str, int, int]]:
        """Key, policy name, context number and seed of every episode."""
        return [(self.key(unit), *unit) for unit in self.units()]

    def described(self) -> dict[str, Any]:
        """Policies, contexts and episodes, JSON-ready."""
        policies = {name: policy.describe() for name, policy in self.policies.items()}
        contexts = [context.model_dump() for context in self.contexts]
        return {"policies": policies, "contexts": contexts, "episodes": self.planned()}

    def key(self, unit: Unit) -> str:
        """Identity of an episode: hash of the policy's description, the context, its number and the seed."""
        name, k, seed = unit
        parts = [self.policies[name].describe(), self.contexts[k].model_dump(), k, seed]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


Source = Callable[[Plan, "deque[Unit]"], Iterator[str]]
"""Plays episodes of a plan and gives a line of the journal for each."""


def run_plan(
    plan: Plan,
    output: Path | None,
    batch: int = BATCH,
    progress: bool = True,
    threads: int | None = None,
    workers: Workers = HERE,
    source: Source | None = None,
    command: str | None = None,
) -> pd.DataFrame:
    """Play what is missing in a folder and return the table of all episodes of the plan.

    Each episode is appended to ``episodes.jsonl`` as it ends, with workers when its portion of up to ``batch`` ends. At
    the end the tables ``episodes.csv``, ``episodes.parquet`` and ``profile.parquet`` are written; until then
    ``unfinished.json`` lists the episodes of the plan.

    Args:
        plan: the evaluation.
        output: the folder; None: nothing is read or written.
        batch: greatest number of episodes side by side.
        progress: whether to show a progress bar.
        threads: greatest number of threads; None: all cores.
        workers: that play episodes, by default this process.
        source: plays instead of this process or workers.
        command: stored as the command line; default: that of this process.

    Raises:
        ValueError: the folder holds episodes of another setting, version or commit; nothing is changed.
    """
    if output is None:
        lines = _lines(plan, deque(plan.units()), batch, threads, workers)
        return gathered(plan.planned(), plan.contexts, {record["key"]: record for record in map(json.loads, lines)})[0]
    journal, done = episodes_of(output), stored_episodes(plan, output)
    units = {plan.key(unit): unit for unit in plan.units()}
    missing = deque(unit for key, unit in units.items() if key not in done)
    announce(Work("episode", len(units), lambda: len(units.keys() & journal.read().keys()), output), quiet=not progress)
    write_json(output / UNFINISHED, origin(command) | plan.described())
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
    files, policies = (*FILES, "setting.json"), plan.described()["policies"]
    write_manifest(output, files, seeds=plan.seeds, command=command, commits=table["commit"], policies=policies)
    (output / UNFINISHED).unlink(missing_ok=True)
    return table


def stored_episodes(plan: Plan, output: Path) -> dict[str, dict[str, Any]]:
    """Records of the episodes that a folder holds, by their keys.

    Raises:
        ValueError: they are of another task, fidelity, version or commit than the plan's, or a file is damaged.
    """
    path, done = output / "setting.json", episodes_of(output).read()
    if path.exists():
        before = _shared(read_json(path, Setting))
        now = _shared(Setting.model_validate_json(json.dumps(plan.setting())))
        different = [name for name in now if before[name] != now[name]]
        code = [f"{name} {before[name] or 'unknown'}, now {now[name]}" for name in ("version", "commit")
                if name in different]  # fmt: skip
        if different:
            raise ValueError(
                f"{output} holds episodes of another setting ({', '.join(different)} differ"
                f"{''.join(f'; {text}' for text in code)}): choose another folder"
            )
    elif done:
        raise FileError(path, "missing beside episodes.jsonl, so nobody knows their task: choose another folder")
    return done


def _shared(setting: Setting) -> dict[str, Any]:
    """What episodes must share; what is only observed may differ, and new fields of the task have their defaults."""
    shared = ("fidelity", "probes", "version", "commit")
    return setting.task.model_dump(exclude=set(SHOWN)) | {name: getattr(setting, name) for name in shared}


def _lines(plan: Plan, missing: deque[Unit], batch: int, threads: int | None, workers: Workers) -> Iterator[str]:
    if workers.here:
        runner = RolloutRunner(plan, missing, batch, threads)
        while not runner.over:
            yield from runner.step()
        return
    size, units = max(min(batch, len(missing) // (2 * workers.jobs)), 1), list(missing)
    portions = [units[begin : begin + size] for begin in range(0, len(units), size)]
    for _, lines in workers.map(lambda portion: list(_lines(plan, deque(portion), size, 1, HERE)), portions):
        yield from lines


def per_metre(profile: list[tuple[float, ...]]) -> dict[str, npt.NDArray[np.float64]]:
    """Rows of control periods (columns ``COLUMNS``) averaged by metre of inserted length, rms values as squares.

    ``inserted_length`` becomes the middle of the metre, ``time`` that of its last period.
    """
    squared = ["radial_rms_m", *HEARD]
    if not profile:
        return {name: np.zeros(0) for name in COLUMNS}
    periods = pd.DataFrame(profile, columns=list(COLUMNS))
    # a period that ends on a whole metre belongs to the metre before
    metre = np.ceil(periods["inserted_length"] - 1e-6) - 1.0
    groups = periods.assign(**{name: periods[name] ** 2 for name in squared}).groupby(metre)
    means = groups.mean()
    means[squared] **= 0.5
    means["time"] = groups["time"].max()
    means["inserted_length"] = means.index + 0.5
    return {name: means[name].to_numpy() for name in COLUMNS}


class RolloutRunner:
    """Episodes of a plan side by side, the next one starting wherever one ends.

    Args:
        plan: the evaluation.
        missing: units to play; those that have begun are taken out.
        batch: greatest number side by side.
        threads: greatest number of threads; None: all cores.

    Attributes:
        episodes: the running episodes.
        units: unit of each lane.
        profile: of each lane a row for each control period of the insertion up to now, columns ``COLUMNS``.
        decided: whether the actions of the next period are decided.
        actions: (N, 2) that were decided last.
        last: the last period; None before the first.
        active: (N,) lanes that take part in the period that was decided last.
    """

    def __init__(self, plan: Plan, missing: deque[Unit], batch: int, threads: int | None) -> None:
        self.plan, self.missing = plan, missing
        count = min(batch, len(missing))
        self.episodes = make_episodes(
            count,
            plan.config,
            threads=threads,
            allow_standstill=True,
            fidelity=plan.fidelity,
            probes=plan.probes,
            surrogate_map=plan.vibration,
        )
        self.units: list[Unit | None] = [None] * count
        self.profile: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
        self.decided = False
        self.actions = np.zeros((count, 2), dtype=np.float32)
        self.last: Step | None = None
        self.active: BoolArray = np.zeros(count, dtype=bool)
        self._probes: dict[int, dict[str, float]] = {}
        self._players = Players(count)
        self._observation: npt.NDArray[np.float32] = self.episodes.observation.copy()

    @property
    def over(self) -> bool:
        """Whether all episodes have ended."""
        return not self.missing and not self.episodes.running.any()

    def step(self) -> Iterator[str]:
        """Play a control period; gives the lines of the journal of the episodes that end with it."""
        self.decide()
        yield from self.advance()

    def decide(self) -> None:
        """Begin episodes in idle lanes, and let the policies decide on the next period."""
        idle = np.flatnonzero(~self.episodes.running).tolist()
        fresh = {k: self.missing.popleft() for k in idle[: len(self.missing)]}
        if fresh:
            for k, unit in fresh.items():
                self.units[k], self.profile[k] = unit, []
                self._players.begin(k, self.plan.policies[unit[0]])
            options = {k: {"context": self.plan.contexts[context]} for k, (_, context, _) in fresh.items()}
            rngs = {k: np.random.default_rng([seed, context]) for k, (_, context, seed) in fresh.items()}
            self._observation, started = self.episodes.reset(list(fresh), rngs, options)
            if self.plan.probes == "random":
                self._probes |= {k: {name: started[k]["probe"][name] for name in RANGES} for k in fresh}
        self.active = self.episodes.running.copy()
        self.actions = self._players.act(self._observation, self.active, self.episodes)
        self.decided = True

    def advance(self) -> Iterator[str]:
        """Play the period that was decided on; gives the lines of the journal of the episodes that end with it."""
        direction = self.episodes.direction.copy()
        step = self.last = self.episodes.step(self.actions, self.active)
        self.decided = False
        self._observation = step.observation
        for k in np.flatnonzero(self.active).tolist():
            info = step.infos[k]
            if direction[k] > 0.0:
                self.profile[k].append(tuple(float(info.get(name, np.nan)) for name in COLUMNS))
            if "episode_kpis" in info:
                unit, metres = self.unit(k), per_metre(self.profile[k])
                profile = {name: [float(f"{v:.5g}") for v in values] for name, values in metres.items()}
                record = {"key": self.plan.key(unit), "unit": unit, "commit": commit(), "kpis": info["episode_kpis"]}
                probe = {"probe": self._probes[k]} if k in self._probes else {}
                yield json.dumps(record | {"profile": profile} | probe) + "\n"

    def observed(self, k: int) -> npt.NDArray[np.float32]:
        """(1, d) observation on which the policy of a lane decides next."""
        return self._observation[k : k + 1]

    def unit(self, k: int) -> Unit:
        """The unit of a lane."""
        unit = self.units[k]
        assert unit is not None
        return unit
