"""Trains agents phase by phase, with a checkpoint after each phase.

All randomness of a phase follows from the seed of the run and the number of the phase, and every phase begins with new
episodes. A run that was killed therefore continues from its last checkpoint to the same weights.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import torch
from filelock import FileLock, Timeout
from pydantic import Field
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.utils import set_random_seed
from tqdm import tqdm

from agents.evaluation.plan import Plan, run_plan
from agents.evaluation.workers import HERE, Workers
from agents.policies.bundle import ALGORITHMS, Agent, Description, write_bundle
from agents.policies.policy import ranges_of
from agents.records.atomic import write_atomically
from agents.records.manifest import origin as made_by
from agents.records.manifest import write_json, write_manifest
from agents.records.models import Stored
from agents.records.reading import FileError, read_csv, read_json
from agents.records.tables import CURVE as CURVE_COLUMNS
from agents.terminal.tables import print_table
from agents.terminal.work import Work, announce
from agents.training.config import Training
from agents.training.imitation import imitate
from agents.training.view_env import ViewVecEnv
from agents.vec_env import ProbeVecEnv
from probe_env.fidelity import resolve_fidelity
from probe_env.files import MEBI, one_line, read_bytes

RUN, CHECKPOINT, BEST, CURVE = "run.json", "checkpoint.pt", "agent.safetensors", "learning.csv"
BUFFER: Final = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""Arrays of a replay buffer."""
MOST_CHECKPOINT: Final = 16384 * MEBI


class Run(Stored):
    """``run.json``: settings of a run, how it was started and resumed."""

    seed: int
    config: Training
    resumed: list[dict[str, Any]] = Field(default_factory=list)


def train_all(
    training: Training, output: Path, resume: bool, workers: Workers = HERE, command: str | None = None
) -> pd.DataFrame:
    """Train every seed, each in ``output``/seed-K; returns the learning curves, one row per phase.

    Workers on other machines must share the file system of ``output``.

    Raises:
        ValueError: a folder holds a run and ``resume`` is not set, or the run in it has other settings.
    """
    origin = made_by(command)
    folders = prepare(training, output, resume, origin)
    phases = training.phases + (training.imitation is not None)

    def done() -> int:
        curves = [folder / CURVE for folder in folders.values()]
        return sum(len(read_csv(curve, CURVE_COLUMNS)) for curve in curves if curve.exists())

    announce(Work("phase", len(folders) * phases, done, output, "the same command with --resume goes on"))
    tasks = [(seed, folder.absolute(), index) for index, (seed, folder) in enumerate(folders.items())]
    curves = dict(workers.map(partial(_train_task, training, origin, workers.here), tasks))
    rows: pd.DataFrame = pd.concat([curves[task] for task in tasks], ignore_index=True)
    return rows


def _train_task(training: Training, origin: dict[str, Any], here: bool, task: tuple[int, Path, int]) -> pd.DataFrame:
    seed, folder, index = task
    return train(training, seed, folder, origin, None if here else 1, 0 if here else index)


def prepare(training: Training, output: Path, resume: bool, origin: dict[str, Any]) -> dict[int, Path]:
    """Check the folder of every seed, then write ``run.json`` in each.

    Raises:
        ValueError: as ``train_all``; nothing was written.
    """
    folders = {seed: output / f"seed-{seed}" for seed in training.seeds}
    settings, teacher = training.model_dump(mode="json"), training.teacher
    runs: dict[Path, dict[str, Any]] = {}
    for seed, folder in folders.items():
        path = folder / RUN
        if folder.exists():
            with run_lock(folder):
                pass
        if not path.exists():
            if (folder / CHECKPOINT).exists():
                raise FileError(path, f"missing beside {CHECKPOINT}: restore it, or choose another folder")
            runs[path] = {"seed": seed} | origin
            continue
        if not resume:
            raise ValueError(f"{folder} holds a run: give --resume to go on with it, or choose another folder")
        run = read_json(path, Run).model_dump(mode="json")
        free = ("seeds", "phases", "search")  # more phases may follow
        different = [name for name in settings if run["config"][name] != settings[name] and name not in free]
        if different:
            raise ValueError(
                f"{folder} holds a run with other settings ({', '.join(different)}): choose another folder"
            )
        resumed = {name: origin[name] for name in ("command", "commit")}
        runs[path] = run | {"resumed": [*run["resumed"], resumed]}
    for path, run in runs.items():
        write_json(path, run | {"config": settings, "teacher": teacher.describe() if teacher else None})
    return folders


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Lock a folder against a second training; the system releases the lock when the process ends.

    Raises:
        ValueError: another process trains there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / "lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise ValueError(f"{folder}: another process trains there: wait for it, or choose another folder") from error
    try:
        yield
    finally:
        lock.release()
        (folder / "lock").unlink(missing_ok=True)


def _write_curve(rows: list[dict[str, Any]], folder: Path) -> None:
    write_atomically(folder / CURVE, pd.DataFrame(rows).to_csv(index=False, float_format="%.6g"))


def train(
    training: Training,
    seed: int,
    folder: Path,
    origin: dict[str, Any],
    threads: int | None = None,
    position: int = 0,
    watch: Callable[[dict[str, Any]], None] = lambda row: None,
) -> pd.DataFrame:
    """Train one seed to its end, from its last checkpoint if there is one.

    Args:
        training: settings.
        seed: of weights, episodes and exploration.
        folder: of checkpoint, best agent, learning curve and logs.
        origin: how the run was started, see ``manifest.origin``.
        threads: of the simulation; default: all cores.
        position: line of the progress bar.
        watch: receives the row of every phase once it is stored, also those before the last checkpoint; an exception
            that it raises ends the training.

    Raises:
        ValueError: another process trains in the folder.
        FileError: the checkpoint is damaged or of another run.
    """
    with run_lock(folder):
        torch.set_num_threads(1)
        model, env, batch = _new_model(training, seed, threads)
        rows = restore(model, folder / CHECKPOINT)
        if rows:
            _write_curve(rows, folder)  # the stored curve may lack the last phase
        for row in rows:
            watch(row)
        imitated = training.imitation.rounds * training.imitation.steps if training.imitation else 0
        done = (imitated if rows else 0) + model.num_timesteps
        total = imitated + training.phases * training.phase_steps
        first = 0 if training.imitation else 1
        with tqdm(total=total, initial=done, desc=f"seed {seed}", unit="step", position=position) as bar:
            for phase in range(first + len(rows), training.phases + 1):
                begin, kernels = time.perf_counter(), batch.kernel_seconds
                _run_phase(training, model, env, phase, folder, bar.update)
                wall = time.perf_counter() - begin
                trained = {"seed": seed, "phase": phase, "steps": model.num_timesteps} | origin
                row = _validate(training, model, trained, folder, rows, threads)
                rows.append(row | {"wall_s": wall, "kernel_s": batch.kernel_seconds - kernels})
                save_checkpoint(model, rows, folder / CHECKPOINT)
                _write_curve(rows, folder)
                watch(rows[-1])
        run = json.loads((folder / RUN).read_text())
        commits = [part["commit"] for part in (run, *run.get("resumed", ()))]
        write_manifest(folder, (RUN, CURVE, BEST), seeds=(seed,), command=origin["command"], commits=commits)
        return pd.DataFrame(rows)


def _new_model(training: Training, seed: int, threads: int | None) -> tuple[BaseAlgorithm, ViewVecEnv, ProbeVecEnv]:
    settings, task = training.environment, training.task.full_observation
    batch = ProbeVecEnv(
        settings.env_id, settings.num_envs, task,
        fidelity=settings.fidelity, contexts=training.trained_in, probes=settings.probes, threads=threads,
        surrogate_map=training.vibration,
    )  # fmt: skip
    env = ViewVecEnv(batch, training.view, task, settings.reward_scale)
    set_random_seed(seed)
    algorithm, name = ALGORITHMS[training.algorithm]
    interval = training.network.noise_interval
    explored = {"use_sde": True, "sde_sample_freq": interval} if interval else {}
    model: BaseAlgorithm = algorithm(
        name, env, policy_kwargs=training.network.arguments(training.algorithm), device="cpu", seed=seed,
        **explored, **training.learning,
    )  # fmt: skip
    return model, env, batch


def _run_phase(
    training: Training, model: BaseAlgorithm, env: ViewVecEnv, phase: int, folder: Path, report: Callable[[int], Any]
) -> None:
    seed = int(np.random.SeedSequence([int(model.seed or 0), phase]).generate_state(1)[0] % 2**31)
    set_random_seed(seed)
    env.seed(seed)
    model.set_env(env, force_reset=True)
    if phase == 0:
        assert training.imitation is not None
        assert training.teacher is not None
        imitate(model, env, training.teacher, training.imitation, report)  # type: ignore[arg-type]
        return

    def advance(*_: Any) -> bool:
        report(env.num_envs)
        return True

    logs = folder / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    formats = [make_output_format("csv", str(logs), f"-{phase:04d}")]  # a resumed phase writes its file again
    formats.append(make_output_format("tensorboard", str(logs / "tensorboard")))
    model.set_logger(Logger(str(logs), formats))
    model.learn(training.phase_steps, advance, reset_num_timesteps=False)
    model.logger.close()


def _validate(
    training: Training,
    model: BaseAlgorithm,
    trained: dict[str, Any],
    folder: Path,
    rows: list[dict[str, Any]],
    threads: int | None,
) -> dict[str, Any]:
    """Validate the agent and store it if it is the best so far; returns the row of the phase."""
    task = training.task.full_observation
    description = Description(
        algorithm=training.algorithm, network=training.network, view=training.view, task=training.task,
        tubes=ranges_of(training.trained_in), trained=trained,
    )  # fmt: skip
    agent = Agent(description, model.policy, task, f"phase {trained['phase']}")
    fidelity = resolve_fidelity(training.validation.fidelity, task.scene, both_ways=task.returns)
    begin = time.perf_counter()
    plan = Plan({"agent": agent}, training.validated_in, (0,), task, fidelity, training.environment.probes)
    table = run_plan(plan, None, threads=threads)
    row = {name: trained[name] for name in ("seed", "phase", "steps")} | {"reward": float(table["reward"].mean())}
    row |= {name: float(table[name].mean()) for name in ("inspection_time_s", "share_within_limit", "diverged")}
    row["validation_s"] = time.perf_counter() - begin
    if all(row["reward"] > before["reward"] for before in rows):
        write_bundle(folder / BEST, description, model.policy)
    return row


def save_checkpoint(model: BaseAlgorithm, rows: list[dict[str, Any]], path: Path) -> None:
    """Write weights, optimisers, step count and learning curve atomically, for SAC also its replay buffer.

    Tensors and plain data only: SB3's own files hold pickles, which run code when they are loaded.
    """
    state: dict[str, Any] = {"parameters": model.get_parameters(), "rows": rows, "steps": model.num_timesteps}
    entropy, replay = getattr(model, "log_ent_coef", None), getattr(model, "replay_buffer", None)
    if entropy is not None:
        state["log_ent_coef"] = entropy.detach()
    if replay is not None:
        state["replay"] = {name: torch.as_tensor(getattr(replay, name)) for name in BUFFER}
        state["replay_end"] = {"pos": int(replay.pos), "full": bool(replay.full)}
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_atomically(path, buffer.getvalue())


def restore(model: BaseAlgorithm, path: Path) -> list[dict[str, Any]]:
    """Set the model to the state of a checkpoint; returns the learning curve until then, empty without a checkpoint.

    Raises:
        FileError: the checkpoint is damaged or of another run. No code in it is run.
    """
    if not path.exists():
        return []
    try:
        state = torch.load(io.BytesIO(read_bytes(path, MOST_CHECKPOINT)), weights_only=True, map_location="cpu")
        rows: list[dict[str, Any]] = state["rows"]
        if any(row["seed"] != model.seed for row in rows) or rows[-1]["steps"] != state["steps"]:
            raise ValueError(f"its learning curve is not of seed {model.seed} and {state['steps']} steps")
        model.set_parameters(state["parameters"])
        if not all(bool(value.isfinite().all()) for value in model.policy.state_dict().values()):
            raise ValueError("weights that are not finite")
        model.num_timesteps = state["steps"]
        if "log_ent_coef" in state:
            model.log_ent_coef.data.copy_(state["log_ent_coef"])  # type: ignore[attr-defined]
        if "replay" in state:
            replay: Any = model.replay_buffer  # type: ignore[attr-defined]
            for name, values in state["replay"].items():
                getattr(replay, name)[:] = values.numpy()
            replay.pos, replay.full = state["replay_end"]["pos"], state["replay_end"]["full"]
    except FileError:
        raise
    except Exception as error:  # of the unpickler and of SB3: whatever the damage leads to
        reason = f"{type(error).__name__}: {one_line(str(error))[:200]}"
        hint = "restore the file, or choose another folder and train again"
        raise FileError(path, f"not a whole checkpoint of this run ({reason}) - {hint}") from error
    return rows


def print_curves(curves: pd.DataFrame) -> None:
    """Print the phases of all seeds."""
    names = {"seed": "seed", "phase": "phase", "steps": "steps", "reward": "reward", "inspection_time_s": "time [s]",
             "share_within_limit": "within the limit", "wall_s": "wall [s]"}  # fmt: skip
    rows = ([f"{value:.4g}" for value in row] for row in curves[list(names)].itertuples(index=False))
    print_table("Validation after each phase", list(names.values()), rows, left=0)
