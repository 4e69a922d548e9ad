"""Training with checkpoints: killed at any moment, it goes on to the same weights.

A run is a row of phases. All that is random in a phase follows from the run's seed and the phase's number, and a phase
begins with new episodes, so weights, optimiser and step count are all that a checkpoint must hold.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.utils import set_random_seed
from tqdm import tqdm

from agents.learning.alone import alone_in
from agents.learning.checkpoints import RUN, Run, read_checkpoint, restore, save_checkpoint, settings_that_differ
from agents.learning.config import Training
from agents.learning.imitation import imitate
from agents.learning.view_env import ViewVecEnv
from agents.policies.bundle import ALGORITHMS, Agent, Description, write_bundle
from agents.policies.domain import ranges_of
from agents.processes.workers import HERE, Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.records.reading import FileError, read_csv, read_json
from agents.records.tables import CURVE as CURVE_COLUMNS
from agents.rollouts.plan import Plan, run_plan
from agents.terminal.tables import print_table
from agents.terminal.work import Work, announce
from agents.vec_env import ProbeVecEnv
from probe_env.fidelity import resolve_fidelity

CHECKPOINT, BEST, CURVE = "checkpoint.pt", "agent.npz", "learning.csv"


def train_all(
    training: Training, output: Path, resume: bool, workers: Workers = HERE, command: str | None = None
) -> pd.DataFrame:
    """Train every seed, each in ``output``/seed-K; returns the learning curves, one row a phase.

    Workers on other machines must share the file system of ``output``.

    Raises:
        ValueError: a folder holds a run and ``resume`` is not set, or the run in it has other settings.
    """
    origin = provenance(command)
    folders = prepare(training, output, resume, origin)
    phases = training.phases + (training.imitation is not None)
    announce(
        Work(
            "phase", len(folders) * phases, lambda: sum(map(_phases_done, folders.values())), output,
            "the same command with --resume goes on",
        )
    )  # fmt: skip
    if workers.here:
        curves = [train(training, seed, folder, origin) for seed, folder in folders.items()]
        return pd.concat(curves, ignore_index=True)
    tasks = [(seed, folder.absolute(), place) for place, (seed, folder) in enumerate(folders.items())]
    done: dict[int, pd.DataFrame] = {}
    for task, curve in workers.map(partial(_train_task, training, origin), tasks):
        done[task[0]] = curve
    return pd.concat([done[seed] for seed in training.seeds], ignore_index=True)


def prepare(training: Training, output: Path, resume: bool, origin: dict[str, Any]) -> dict[int, Path]:
    """The folder of every seed with a note of what is run there, so that it can be trained.

    Raises:
        ValueError: as ``train_all``; nothing was written.
    """
    folders = {seed: output / f"seed-{seed}" for seed in training.seeds}
    for folder in folders.values():
        _check_folder(training, folder, resume)
    _check_checkpoints(training, folders)
    for seed, folder in folders.items():
        _note_run(training, seed, folder, origin)
    return folders


def _train_task(training: Training, origin: dict[str, Any], task: tuple[int, Path, int]) -> pd.DataFrame:
    seed, folder, place = task
    return train(training, seed, folder, origin, 1, place)


def _phases_done(folder: Path) -> int:
    """Phases that a run's curve holds, and so its checkpoint."""
    curve = folder / CURVE
    return len(read_csv(curve, CURVE_COLUMNS)) if curve.exists() else 0


def _write_curve(rows: list[dict[str, Any]], folder: Path) -> None:
    write_atomically(folder / CURVE, pd.DataFrame(rows).to_csv(index=False, float_format="%.6g"))


def _note_run(training: Training, seed: int, folder: Path, origin: dict[str, Any]) -> None:
    """Write what is run; a resumed run keeps how it began and lists how it went on."""
    path = folder / RUN
    begun: dict[str, Any] = {"seed": seed} | origin
    if path.exists():
        begun = json.loads(read_json(path, Run).model_dump_json())
        begun["resumed"] = [*begun.get("resumed", []), {"command": origin["command"], "commit": origin["commit"]}]
    teacher = training.teacher.describe() if training.teacher else None
    write_json(path, begun | {"config": json.loads(training.model_dump_json()), "teacher": teacher})


def _check_folder(training: Training, folder: Path, resume: bool) -> None:
    if folder.exists():
        with alone_in(folder):
            pass
    if not (folder / RUN).exists():
        if (folder / CHECKPOINT).exists():
            raise FileError(folder / RUN, f"missing beside {CHECKPOINT}: restore it, or choose another folder")
        return
    if not resume:
        raise ValueError(f"{folder} holds a run: give --resume to go on with it, or choose another folder")
    # settings that are newer than the run have their defaults
    different = settings_that_differ(read_json(folder / RUN, Run).config, training)
    if different:
        raise ValueError(f"{folder} holds a run with other settings ({', '.join(different)}): choose another folder")


def _check_checkpoints(training: Training, folders: dict[int, Path]) -> None:
    """Raise unless all checkpoints can be gone on from: before any seed is trained."""
    for seed, folder in folders.items():
        if (folder / CHECKPOINT).exists():
            model, env = _new_model(training, seed, None)
            read_checkpoint(folder / CHECKPOINT, model, training)
            env.close()


def _new_model(training: Training, seed: int, threads: int | None) -> tuple[BaseAlgorithm, ViewVecEnv]:
    """The algorithm with new weights and the environments that it learns in."""
    shown = training.shown_task
    batch = ProbeVecEnv(
        training.environment.env_id, training.environment.num_envs, shown,
        fidelity=training.environment.fidelity, contexts=training.trained_in,
        probes=training.environment.probes, threads=threads, surrogate_map=training.vibration,
    )  # fmt: skip
    env = ViewVecEnv(batch, training.view, shown, training.environment.reward_scale)
    set_random_seed(seed)
    algorithm, name = ALGORITHMS[training.algorithm]
    interval = training.network.noise_interval
    explored = {"use_sde": True, "sde_sample_freq": interval} if interval else {}
    model: BaseAlgorithm = algorithm(
        name, env, policy_kwargs=training.network.arguments(training.algorithm), device="cpu", seed=seed,
        **explored, **training.learning,
    )  # fmt: skip
    return model, env


def train(
    training: Training,
    seed: int,
    folder: Path,
    origin: dict[str, Any],
    threads: int | None = None,
    place: int = 0,
    watch: Callable[[dict[str, Any]], None] = lambda row: None,
) -> pd.DataFrame:
    """Train one seed to its end, from its last checkpoint if there is one.

    Args:
        training: settings.
        seed: of weights, episodes and exploration.
        folder: of checkpoint, best agent (``agent.npz``), learning curve and logs.
        origin: how the run was started, see ``provenance``.
        threads: of the simulation; default: all cores.
        place: line of the progress bar.
        watch: is given the row of every phase once it is stored, those before the last checkpoint too; what it raises
            ends the training.

    Raises:
        ValueError: another process trains in the folder.
    """
    with alone_in(folder):
        return _trained(training, seed, folder, origin, threads, place, watch)


def _trained(
    training: Training,
    seed: int,
    folder: Path,
    origin: dict[str, Any],
    threads: int | None,
    place: int,
    watch: Callable[[dict[str, Any]], None],
) -> pd.DataFrame:
    torch.set_num_threads(1)
    model, env = _new_model(training, seed, threads)
    rows = restore(model, folder / CHECKPOINT)
    imitated = training.imitation.rounds * training.imitation.steps if training.imitation else 0
    if rows:
        _write_curve(rows, folder)  # the checkpoint tells: the curve may be of the phase before
    for row in rows:
        watch(row)
    done = (imitated if rows else 0) + model.num_timesteps
    total = imitated + training.phases * training.phase_steps
    first = 0 if training.imitation else 1
    with tqdm(total=total, initial=done, desc=f"seed {seed}", unit="step", position=place) as bar:
        for phase in range(first + len(rows), training.phases + 1):
            begin = time.perf_counter()
            set_random_seed(_seed_of(seed, phase))
            env.seed(_seed_of(seed, phase))
            model._last_obs = None  # new episodes
            batch = env.venv
            assert isinstance(batch, ProbeVecEnv)
            kernels = batch.kernel_seconds
            if phase == 0:
                assert training.imitation is not None
                assert training.teacher is not None
                imitate(model, env, training.teacher, training.imitation, bar.update)  # type: ignore[arg-type]
            else:
                model.set_logger(_logger(folder, phase))
                model.learn(training.phase_steps, _Bar(bar.update), reset_num_timesteps=False)
                model.logger.close()
            wall = time.perf_counter() - begin
            trained = {"seed": seed, "phase": phase, "steps": model.num_timesteps} | origin
            rows.append(_validated(training, model, trained, folder, rows, threads))
            rows[-1] |= {"wall_s": wall, "kernel_s": batch.kernel_seconds - kernels}
            save_checkpoint(model, rows, folder / CHECKPOINT)
            _write_curve(rows, folder)
            watch(rows[-1])
    return pd.DataFrame(rows)


def _validated(
    training: Training,
    model: BaseAlgorithm,
    trained: dict[str, Any],
    folder: Path,
    rows: list[dict[str, Any]],
    threads: int | None,
) -> dict[str, Any]:
    """Validate the model as it is, keep it if it is the best so far; the phase's row.

    ``trained``: seed, phase and steps so far, and how the run was started.
    """
    description = Description(
        algorithm=training.algorithm, network=training.network, view=training.view, task=training.task,
        tubes=ranges_of(training.trained_in), trained=trained,
    )  # fmt: skip
    agent = Agent(description, model.policy, training.shown_task, f"phase {trained['phase']}")
    fidelity = resolve_fidelity(training.validation.fidelity, training.task.scene, both_ways=training.task.returns)
    begin = time.perf_counter()
    plan = Plan(
        {"agent": agent}, training.validated_in, (0,), training.shown_task, fidelity, training.environment.probes
    )
    table = run_plan(plan, None, threads=threads)
    row = {name: trained[name] for name in ("seed", "phase", "steps")} | {"reward": float(table["reward"].mean())}
    row |= {name: float(table[name].mean()) for name in ("inspection_time_s", "share_within_limit", "diverged")}
    row["validation_s"] = time.perf_counter() - begin
    if all(row["reward"] > before["reward"] for before in rows):
        write_bundle(folder / BEST, description, model.policy)
    return row


def _seed_of(seed: int, phase: int) -> int:
    return int(np.random.SeedSequence([seed, phase]).generate_state(1)[0] % 2**31)


def _logger(folder: Path, phase: int) -> Logger:
    """SB3's CSV, a file a phase (a resumed phase writes its own again), and TensorBoard, which gathers them."""
    logs = folder / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    formats = [make_output_format("csv", str(logs), f"-{phase:04d}")]
    formats.append(make_output_format("tensorboard", str(logs / "tensorboard")))
    return Logger(str(logs), formats)


def print_curves(curves: pd.DataFrame) -> None:
    """The phases of all seeds on the terminal."""
    names = {"seed": "seed", "phase": "phase", "steps": "steps", "reward": "reward", "inspection_time_s": "time [s]",
             "share_within_limit": "within the limit", "wall_s": "wall [s]"}  # fmt: skip
    rows = ([f"{value:.4g}" for value in row] for row in curves[list(names)].itertuples(index=False))
    print_table("Validation after each phase", list(names.values()), rows, left=0)


class _Bar(BaseCallback):
    """Moves the progress bar."""

    def __init__(self, update: Callable[[int], Any]) -> None:
        super().__init__()
        self.update = update

    def _on_step(self) -> bool:
        self.update(self.training_env.num_envs)
        return True
