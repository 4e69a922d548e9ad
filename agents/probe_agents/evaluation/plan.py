"""Runs a plan: policies x contexts x seeds in a batch, resumable, into one table of episodes.

An episode depends only on its policy, context and seed, so an interrupted evaluation continues to the same table.
"""

import hashlib
import io
import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from probe_agents.evaluation import repeat
from probe_agents.evaluation.folder import (
    FILES,
    UNFINISHED,
    Planned,
    ReportSettings,
    collect_tables,
    episodes_of,
)
from probe_agents.evaluation.folder import EpisodeId as EpisodeId
from probe_agents.evaluation.kpis import PROFILE_COLUMNS, PROFILE_COLUMNS_INSTRUMENT
from probe_agents.evaluation.profiles import file_name
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.planner import InsertionPlanner
from probe_agents.policies.policy import Policy as Policy
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import commit, origin, write_json
from probe_agents.records.result_folder import ResultFolder
from probe_agents.terminal.work import Work, announce
from probe_env import Context, Fidelity
from probe_env.arrays import BoolArray
from probe_env.design import RANGES
from probe_env.envs.episodes import Episodes, Step
from probe_env.envs.episodes.starts import Probes
from probe_env.envs.plants import Bundle
from probe_env.envs.task.config import VISIBLE_FIELDS, TaskConfig, describe
from probe_env.envs.trials import PolicyBatch
from probe_env.envs.vibration_map import VibrationMap, stored_map
from probe_env.fidelity import PRESETS, measured_errors
from probe_env.inspection.metrics import with_pod_columns
from probe_env.machine import available_cores

PERIOD: Final = (*PROFILE_COLUMNS, "axial_velocity_rms")
"""Columns of a control period in a runner; rms of the sensor's axial velocity [m/s], NaN: not simulated."""
BATCH: Final = 16
"""Number of episodes in a batch."""
SECONDS_PER_METRE, MEAN_FRACTION = 5.5, 0.6
"""Of a usual insertion: time per metre [s/m], and mean inserted length over that of the helix."""
FULL_LANES: Final = 0.35
"""Time of evaluations in full batches over that of the measured costs: 16 episodes at fast took 11 s of a core."""


@dataclass(frozen=True)
class Plan:
    """An evaluation: every policy on every context with every seed.

    Attributes:
        policies: by name.
        contexts: the tubes.
        seeds: seeds of sensor noise and start.
        config: the task.
        fidelity: fidelity of the simulation, resolved for the scene (``fidelity.resolve_fidelity``).
        probes: "scene", or "random": context and seed select a ``Design``, the same for every policy.
        vibration: vibration map of fidelity "surrogate"; default: the shipped one.
        bundle: bundle of tubes whose hours are reported; None: no hours.
        plant: name of the plant, for the report.

    Raises:
        ValueError: a policy was made for other ranges of feed or air, so its actions mean other values.
    """

    policies: Mapping[str, Policy]
    contexts: Sequence[Context]
    seeds: Sequence[int] = (0,)
    config: TaskConfig = field(default_factory=TaskConfig)
    fidelity: Fidelity = PRESETS["fast"]
    probes: Probes = "scene"
    vibration: VibrationMap | None = None
    bundle: Bundle | None = None
    plant: str | None = None

    def __post_init__(self) -> None:
        for name, policy in self.policies.items():
            task = getattr(policy, "config", None)
            if not isinstance(task, TaskConfig):
                continue
            for limits in ("feed_speeds", "air_supply_rates"):
                policy_range, task_range = getattr(task, limits), getattr(self.config, limits)
                if policy_range != task_range:
                    raise ValueError(
                        f"policy {name}: {limits} = {policy_range} differs from {task_range} of the task:"
                        " make the policy for this task, or load its bundle with the task's config"
                    )

    def folder(self, path: Path) -> ResultFolder:
        """The folder of the episodes; what is observed changes none, so it may differ."""
        surrogate = None if self.fidelity.simulates else (self.vibration or stored_map()).digest
        identity = describe(self.config) | {"fidelity": self.fidelity.model_dump(), "probes": self.probes}
        free = ("observations", *(f"task.{name}" for name in VISIBLE_FIELDS))
        return ResultFolder(path, identity | {"surrogate_map": surrogate}, free=free)

    def episode_ids(self) -> list[EpisodeId]:
        """Policy name, context number and seed of every episode."""
        return [(name, k, seed) for name in self.policies for seed in self.seeds for k in range(len(self.contexts))]

    def planned(self) -> list[Planned]:
        """Key, policy name, context number and seed of every episode."""
        return [(self.key(episode), *episode) for episode in self.episode_ids()]

    def described(self) -> dict[str, Any]:
        """Policies, contexts and episodes, JSON-ready."""
        policies = {name: policy.describe() for name, policy in self.policies.items()}
        contexts = [context.model_dump() for context in self.contexts]
        return {"policies": policies, "contexts": contexts, "episodes": self.planned()}

    def key(self, episode: EpisodeId) -> str:
        """Key of an episode: hash of the policy's description, the context, its number and the seed."""
        name, k, seed = episode
        parts = [self.policies[name].describe(), self.contexts[k].model_dump(), k, seed]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


Records = Iterator[dict[str, Any]]
Source = Callable[[Plan, "deque[EpisodeId]"], Records]
"""Runs episodes of a plan and yields a record of the journal for each."""


def run_plan(
    plan: Plan,
    output: Path | None,
    batch: int = BATCH,
    progress: bool = True,
    threads: int | None = None,
    workers: Workers = HERE,
    source: Source | None = None,
    command: str | None = None,
    report: ReportSettings | None = None,
) -> pd.DataFrame:
    """Run the episodes that a folder lacks; returns the table of all episodes of the plan.

    Each episode is appended to ``episodes.jsonl`` when it ends; with workers, when its batch ends. ``unfinished.json``
    lists the planned episodes until ``episodes.csv``, ``episodes.parquet`` and ``profile.parquet`` are written.

    Args:
        plan: the evaluation.
        output: the folder; None: nothing is read or written.
        batch: maximum number of episodes in a batch.
        progress: whether to show a progress bar.
        threads: maximum number of threads; None: all cores.
        workers: workers that run the episodes; default: this process.
        source: runs the episodes instead of ``workers``.
        command: command line to store; default: the one of this process.
        report: settings of the report to store.

    Raises:
        ValueError: the folder holds episodes of other settings or of other code; nothing is changed.
    """
    if output is None:
        done = {record["key"]: record for record in _records(plan, deque(plan.episode_ids()), batch, threads, workers)}
        return collect_tables(plan.planned(), plan.contexts, done)[0]
    journal = episodes_of(output)
    with plan.folder(output).open(journal.path.name) as folder:
        done = journal.read()
        if report is not None:
            write_json(output / "report.json", report.to_json())
        episodes = {plan.key(episode): episode for episode in plan.episode_ids()}
        missing = deque(episode for key, episode in episodes.items() if key not in done)
        cores = min(workers.jobs if not workers.here else threads or available_cores(), available_cores())
        announce(
            Work(
                "episode", len(episodes), lambda: len(episodes.keys() & journal.read().keys()), output,
                seconds=sum(core_seconds(plan, name) for name, _, _ in missing) / max(len(missing), 1) / cores,
            ),
            quiet=not progress,
        )  # fmt: skip
        write_json(output / UNFINISHED, origin(command) | plan.described())
        if missing:
            with (
                journal.appending() as append,
                tqdm(total=len(missing), desc="evaluate", unit="episode", disable=not progress) as bar,
            ):
                for record in source(plan, missing) if source else _records(plan, missing, batch, threads, workers):
                    append(record)
                    bar.update()
            done = journal.read()
        return _write_tables(plan, folder, done, command)


def _write_tables(
    plan: Plan, folder: ResultFolder, done: Mapping[str, dict[str, Any]], command: str | None
) -> pd.DataFrame:
    """Write the tables and the manifest of finished episodes; returns the table of episodes."""
    output = folder.path
    table, profile = collect_tables(plan.planned(), plan.contexts, done)
    write_atomically(output / "episodes.csv", table.to_csv(index=False, float_format="%.8g"))
    for name, frame in (("episodes", table), ("profile", profile)):
        buffer = io.BytesIO()
        frame.to_parquet(buffer, index=False)
        write_atomically(output / f"{name}.parquet", buffer.getvalue())
    files, policies = (*FILES, *_write_repeat(plan, table, profile, output)), plan.described()["policies"]
    folder.write_manifest(*files, seeds=plan.seeds, command=command, commits=table["commit"], policies=policies)
    (output / UNFINISHED).unlink(missing_ok=True)
    return table


def _write_repeat(plan: Plan, table: pd.DataFrame, profile: pd.DataFrame, output: Path) -> list[str]:
    """Write the metres to repeat, and a schedule of them for each policy; returns the names of the files."""
    if not repeat.is_judged(plan.config):
        return []
    cases = repeat.cases_of(table, profile, plan.config)
    contents = {"repeat.csv": repeat.repeat_table(cases).to_csv(index=False, float_format="%.6g")}
    for policy in plan.policies:
        own = [(*part, plan.contexts[int(key[1])]) for key, part in cases.items() if key[0] == policy]
        if any(len(intervals) for _, intervals, _ in own):
            schedule = repeat.repeat_schedule(
                own, plan.config, plan.vibration or stored_map(), plan.fidelity.time_lapse
            )
            contents[f"repeat-{file_name(policy)}.csv"] = schedule.to_csv()
    for name, text in contents.items():
        write_atomically(output / name, text)
    return list(contents)


def core_seconds(plan: Plan, policy: str) -> float:
    """Rough time of an episode on one core [s], from the measured costs of methods; 0 if none is measured.

    A planner also simulates its candidates.
    """
    costs = [
        row.cost * row.fidelity.time_lapse
        for row in measured_errors()
        if plan.fidelity.simulates and row.fidelity.numerics == plan.fidelity.numerics
    ]
    scene, planner, planned = plan.config.scene, plan.policies[policy], 0.0
    if isinstance(planner, InsertionPlanner):
        planned = planner.copies * planner.candidates * planner.periods / planner.every
    motion = scene.tube.helix_length * SECONDS_PER_METRE / plan.fidelity.time_lapse
    pitches = MEAN_FRACTION * scene.tube.helix_length / scene.probe.float_pitch
    return FULL_LANES * (1.0 + planned) * float(np.median(costs or [0.0])) * pitches * motion


def _records(plan: Plan, missing: deque[EpisodeId], batch: int, threads: int | None, workers: Workers) -> Records:
    """Run the missing episodes; yields the record of each when it ends, with workers when its batch ends."""
    if workers.here:
        runner = RolloutRunner(plan, missing, batch, threads)
        while not runner.over:
            yield from runner.step()
        return
    size, episodes = max(min(batch, len(missing) // (2 * workers.jobs)), 1), list(missing)
    portions = [episodes[begin : begin + size] for begin in range(0, len(episodes), size)]
    for _, records in workers.map(lambda portion: list(_records(plan, deque(portion), size, 1, HERE)), portions):
        yield from records


def per_metre(profile: list[tuple[float, ...]]) -> dict[str, npt.NDArray[np.float64]]:
    """Means of control periods (``PERIOD``) over each metre of inserted length; of squares for rms values.

    ``inserted_length`` is the middle of the metre, ``time`` the end of its last period; also its ``highest_feed``.
    """
    squared = ["radial_rms_m", "noise_rms_m", "axial_velocity_rms"]
    periods = pd.DataFrame(profile, columns=list(PERIOD), dtype=float)
    metre = np.ceil(periods["inserted_length"] - 1e-6) - 1.0  # a period that ends on a whole metre is in that before
    groups = periods.assign(**{name: periods[name] ** 2 for name in squared}).groupby(metre)
    means = groups.mean()
    means[squared] **= 0.5
    means["time"], means["highest_feed"] = groups["time"].max(), groups["feed_speed"].max()
    means["inserted_length"] = means.index + 0.5
    return {str(name): means[name].to_numpy() for name in means}


class RolloutRunner:
    """Runs a plan in a batch; a lane starts the next episode when its episode ends.

    Args:
        plan: the evaluation.
        missing: episodes to run; started ones are removed.
        batch: maximum number of lanes.
        threads: maximum number of threads; None: all cores.

    Attributes:
        episodes: the running episodes.
        ids: episode of each lane.
        profile: for each lane, one row per control period of the insertion so far, columns ``PERIOD``.
        decided: whether ``actions`` are those of the next period.
        actions: (N, 2) last actions.
        last: the last period; None before the first.
        active: (N,) lanes that ``actions`` are for.
    """

    def __init__(self, plan: Plan, missing: deque[EpisodeId], batch: int, threads: int | None) -> None:
        self.plan, self.missing = plan, missing
        count = min(batch, len(missing))
        self.episodes = Episodes(
            count,
            plan.config,
            threads=threads,
            allow_standstill=True,
            fidelity=plan.fidelity,
            probes=plan.probes,
            surrogate_map=plan.vibration,
        )
        self.ids: list[EpisodeId | None] = [None] * count
        self.profile: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
        self.decided = False
        self.actions = np.zeros((count, 2), dtype=np.float32)
        self.last: Step | None = None
        self.active: BoolArray = np.zeros(count, dtype=bool)
        self._probes: dict[int, dict[str, float]] = {}
        self._players = PolicyBatch(count)
        self._observation: npt.NDArray[np.float32] = self.episodes.observation.copy()

    @property
    def over(self) -> bool:
        """Whether all episodes have ended."""
        return not self.missing and not self.episodes.running.any()

    def step(self) -> Records:
        """Run a control period; yields the records of the episodes that end."""
        self.next_actions()
        yield from self.advance()

    def next_actions(self) -> None:
        """Start episodes in idle lanes and compute the actions of the next period."""
        idle = np.flatnonzero(~self.episodes.running).tolist()
        fresh = {k: self.missing.popleft() for k in idle[: len(self.missing)]}
        if fresh:
            for k, episode in fresh.items():
                self.ids[k], self.profile[k] = episode, []
                self._players.begin(k, self.plan.policies[episode[0]])
            options = {k: {"context": self.plan.contexts[context]} for k, (_, context, _) in fresh.items()}
            rngs = {k: np.random.default_rng([seed, context]) for k, (_, context, seed) in fresh.items()}
            self._observation, started = self.episodes.reset(list(fresh), rngs, options)
            if self.plan.probes == "random":
                self._probes |= {k: {name: started[k]["probe"][name] for name in RANGES} for k in fresh}
        self.active = self.episodes.running.copy()
        self.actions = self._players.act(self._observation, self.active, self.episodes)
        self.decided = True

    def advance(self) -> Records:
        """Apply ``actions`` for a period; yields the records of the episodes that end."""
        direction = self.episodes.direction.copy()
        step = self.last = self.episodes.step(self.actions, self.active)
        self.decided = False
        self._observation = step.observation
        assert self.episodes.window is not None
        axial = self.episodes.window.statistics.get("axial_velocity_rms_m_per_s")
        for k in np.flatnonzero(self.active).tolist():
            info = step.infos[k]
            if direction[k] > 0.0:
                values = (*(info.get(name, np.nan) for name in PROFILE_COLUMNS), np.nan if axial is None else axial[k])
                self.profile[k].append(tuple(map(float, values)))
            if "episode_kpis" in info:
                episode, metres = self.episode_id(k), per_metre(self.profile[k])
                kpis, names, config = with_pod_columns(info["episode_kpis"]), PROFILE_COLUMNS, self.plan.config
                if repeat.is_judged(config):
                    names, permitted = (*names, *PROFILE_COLUMNS_INSTRUMENT), config.permitted_speed[0]
                    metres["permitted_speed"] = np.full_like(
                        metres["time"], permitted if permitted < np.inf else np.nan
                    )
                    segments = repeat.segments_of(metres, config, kpis["complete"] > 0.0, kpis["lost_drive"] > 0.0)
                    kpis |= repeat.instrument_kpis(segments, config)
                profile = {name: [float(f"{v:.5g}") for v in metres[name]] for name in names}
                record = {"key": self.plan.key(episode), "episode": episode, "commit": commit(), "kpis": kpis}
                probe = {"probe": self._probes[k]} if k in self._probes else {}
                yield record | {"profile": profile} | probe

    def observed(self, k: int) -> npt.NDArray[np.float32]:
        """(1, d) observation for the next action of a lane."""
        return self._observation[k : k + 1]

    def episode_id(self, k: int) -> EpisodeId:
        """The episode of a lane."""
        episode = self.ids[k]
        assert episode is not None
        return episode
