"""Trains agents phase by phase, with a checkpoint after each phase.

The seed of a run and the number of a phase determine all random numbers of the phase, which begins with new episodes.
An interrupted run therefore continues from its last checkpoint to the same weights.
"""

import hashlib
import io
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn, VecEnvWrapper
from tqdm import tqdm

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.bundle import Agent, Description, StoredNetwork, write_bundle
from probe_agents.policies.policy import Policy, ranges_of
from probe_agents.policies.view import Rows, View
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import origin as made_by
from probe_agents.records.result_folder import ResultFolder, run_lock
from probe_agents.records.tables import CURVE as CURVE_COLUMNS
from probe_agents.records.tables import read_csv
from probe_agents.terminal.tables import print_table
from probe_agents.terminal.work import Work, announce
from probe_agents.training.config import Imitation, Training
from probe_agents.vec_env import ProbeVecEnv
from probe_env.envs.task.config import TaskConfig
from probe_env.fidelity import SURROGATE, Fidelity
from probe_env.files import MEBI, FileError, one_line, read_bytes

RUN, CHECKPOINT, BEST, CURVE = "run.json", "checkpoint.pt", "agent.safetensors", "learning.csv"
DIGEST: Final = 32
"""Bytes of the SHA-256 at the start of a checkpoint."""
MAX_CHECKPOINT: Final = 1024 * MEBI
VALIDATED: Final = ("inspection_time_s", "share_within_limit", "diverged")
"""Columns of the learning curve, next to the reward."""
MINIBATCH: Final = 256
"""Batch size of the imitation."""
Floats = npt.NDArray[np.float32]


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
    phases = training.phases + training.warm_start

    def done() -> int:
        curves = [folder / CURVE for folder in folders.values()]
        return sum(len(read_csv(curve, CURVE_COLUMNS)) for curve in curves if curve.exists())

    announce(Work("phase", len(folders) * phases, done, output, "continue with the same command and --resume"))
    one = partial(train, training, output.absolute(), origin, threads=None if workers.here else 1)
    curves = dict(workers.map(one, training.seeds))
    rows: pd.DataFrame = pd.concat([curves[seed] for seed in training.seeds], ignore_index=True)
    return rows


def prepare(training: Training, output: Path, resume: bool, origin: dict[str, Any]) -> dict[int, Path]:
    """Check the folder of every seed, then write ``run.json`` in each."""
    folders = {seed: run_folder(training, output, seed, origin) for seed in training.seeds}
    for folder in folders.values():
        if folder.path.exists():
            with run_lock(folder.path):
                folder.check(CHECKPOINT)
        if folder.file.exists() and not resume:
            raise ValueError(f"{folder.path} holds a run: continue it with --resume, or choose another folder")
    for folder in folders.values():
        with folder.open(**origin):
            pass
    return {seed: folder.path for seed, folder in folders.items()}


def run_folder(training: Training, output: Path, seed: int, origin: Mapping[str, Any]) -> ResultFolder:
    """The folder of a seed; more phases may follow, with other seeds next to it."""
    teacher, vibration = training.teacher, training.vibration
    identity = {
        "seed": seed, "config": training.model_dump(mode="json"), "teacher": teacher.describe() if teacher else None,
        "surrogate_map": vibration.digest if vibration else None, "version": origin["version"],
        "commit": origin["commit"],
    }  # fmt: skip
    free = ("config.seeds", "config.phases")
    return ResultFolder(output / f"seed-{seed}", identity, "this agent was trained", free, RUN)


def _write_curve(rows: list[dict[str, Any]], folder: Path) -> None:
    write_atomically(folder / CURVE, pd.DataFrame(rows).to_csv(index=False, float_format="%.6g"))


def train(
    training: Training,
    output: Path,
    origin: dict[str, Any],
    seed: int,
    threads: int | None = None,
) -> pd.DataFrame:
    """Train one seed to its end, starting from its last checkpoint if there is one.

    Args:
        training: settings.
        output: folder; seed-K in it holds checkpoint, best agent, learning curve and logs.
        origin: how the run was started, see ``manifest.origin``.
        seed: of weights, episodes and exploration.
        threads: of the simulation; default: all cores.

    Raises:
        FileError: another process trains in the folder; the checkpoint is damaged or of another run.
    """
    position = training.seeds.index(seed) if threads else 0  # of the progress bar
    with run_folder(training, output, seed, origin).open(CHECKPOINT, **origin) as result:
        folder = result.path
        torch.set_num_threads(1)
        task, network = training.task.full_observation, StoredNetwork(**training.network.model_dump())
        plan = Plan({}, training.validated_in, (0,), task, training.validation_fidelity, training.environment.probes)
        env = _environments(training, training.environment.fidelity, threads)
        set_random_seed(seed)
        learning = training.learning.model_dump(exclude_none=True)
        sizes = network.arguments("ppo")
        model = PPO("MlpPolicy", env, policy_kwargs=sizes, device="cpu", seed=seed, **learning)
        rows = restore(model, folder / CHECKPOINT)
        if rows:
            _write_curve(rows, folder)  # the stored curve may lack the last phase
        imitated = training.imitation.rounds * training.imitation.steps if training.imitation else 0
        done = (imitated if rows else 0) + model.num_timesteps
        total = imitated + training.pretraining_steps + training.phases * training.phase_steps
        first = 0 if training.warm_start else 1
        with tqdm(total=total, initial=done, desc=f"seed {seed}", unit="step", position=position) as bar:
            for phase in range(first + len(rows), training.phases + 1):
                begin, kernels = time.perf_counter(), env.batch.kernel_seconds
                _run_phase(training, model, env, phase, folder, bar.update)
                learned, kernels = time.perf_counter(), env.batch.kernel_seconds - kernels
                row: dict[str, Any] = {"seed": seed, "phase": phase, "steps": model.num_timesteps}
                description = Description(
                    algorithm="ppo", network=network, view=training.view, task=training.task,
                    tubes=ranges_of(training.trained_in), trained=row | origin,
                )  # fmt: skip
                agent = Agent(description, model.policy, task, f"phase {phase}")
                table = run_plan(replace(plan, policies={"agent": agent}), None, threads=threads)
                row |= {name: float(table[name].mean()) for name in ("reward", *VALIDATED)}
                row |= {"validation_s": time.perf_counter() - learned, "wall_s": learned - begin, "kernel_s": kernels}
                if all(row["reward"] > before["reward"] for before in rows):
                    write_bundle(folder / BEST, description, model.policy)
                rows.append(row)
                save_checkpoint(model, rows, folder / CHECKPOINT)
                _write_curve(rows, folder)
        result.write_manifest(CURVE, BEST, seeds=(seed,), command=origin["command"], commits=(origin["commit"],))
        return pd.DataFrame(rows)


class ViewVecEnv(VecEnvWrapper):
    """The environments with the features and actions of a view; rewards are multiplied by ``reward_scale``.

    ``rows`` holds the observations (N, d) of the environments after the last step.
    """

    def __init__(self, batch: ProbeVecEnv, view: View, config: TaskConfig, reward_scale: float) -> None:
        super().__init__(batch, *view.spaces)
        view.columns(config)
        self.batch, self.view, self.config, self.reward_scale = batch, view, config, reward_scale
        self.rows: Rows = np.zeros((batch.num_envs, len(config.observations)))
        self._memory: Rows | None = None

    def reset(self) -> VecEnvObs:
        """Start all episodes."""
        self.rows = np.asarray(self.venv.reset())
        features, self._memory = self.view.features(self.config, self.rows, None, np.ones(self.num_envs, dtype=bool))
        return features

    def step_async(self, actions: np.ndarray) -> None:
        """Convert the actions to those of the environment and store them."""
        self.venv.step_async(self.view.env_actions(self.config, actions))

    def step_wait(self) -> VecEnvStepReturn:
        """One control period; ``terminal_observation`` has the last features of an ended episode."""
        rows, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if len(ended):
            assert self._memory is not None
            last = np.array([infos[k]["terminal_observation"] for k in ended])
            features, _ = self.view.features(self.config, last, self._memory[ended], np.zeros(len(ended), dtype=bool))
            for k, terminal in zip(ended, features, strict=True):
                infos[k]["terminal_observation"] = terminal
        self.rows = np.asarray(rows)
        features, self._memory = self.view.features(self.config, self.rows, self._memory, np.asarray(dones))
        return features, np.asarray(rewards * self.reward_scale, dtype=np.float32), dones, infos


def _environments(training: Training, fidelity: str | Fidelity, threads: int | None) -> ViewVecEnv:
    """Environments of the training at a fidelity, with the features and actions of the agent."""
    settings, task = training.environment, training.task.full_observation
    batch = ProbeVecEnv(
        settings.env_id, settings.num_envs, task, fidelity=fidelity, contexts=training.trained_in,
        probes=settings.probes, threads=threads, surrogate_map=training.vibration,
    )  # fmt: skip
    return ViewVecEnv(batch, training.view, task, settings.reward_scale)


def _run_phase(
    training: Training, model: PPO, env: ViewVecEnv, phase: int, folder: Path, report: Callable[[int], Any]
) -> None:
    seed = int(np.random.SeedSequence([int(model.seed or 0), phase]).generate_state(1)[0] % 2**31)
    set_random_seed(seed)
    if phase == 0 and training.pretraining_steps:
        env = _environments(training, SURROGATE, None)
    env.seed(seed)
    model.set_env(env, force_reset=True)
    if phase == 0 and training.imitation is not None:
        assert training.teacher is not None
        imitate(model, env, training.teacher, training.imitation, report)
        return

    def advance(*_: Any) -> bool:
        report(env.num_envs)
        return True

    logs = folder / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    formats = [make_output_format("csv", str(logs), f"-{phase:04d}")]  # a resumed phase writes its file again
    formats.append(make_output_format("tensorboard", str(logs / "tensorboard")))
    model.set_logger(Logger(str(logs), formats))
    steps = training.phase_steps if phase else training.pretraining_steps
    model.learn(steps, advance, reset_num_timesteps=False)
    model.logger.close()


def imitate(model: PPO, env: ViewVecEnv, teacher: Policy, settings: Imitation, report: Callable[[int], Any]) -> None:
    """Warm start of PPO: the network imitates a teacher (DAgger: Ross, Gordon, Bagnell 2011).

    The teacher acts in the first round, the network in the others; the critic learns the return.

    Args:
        model: PPO on ``env``.
        env: environments whose task has the observations of the teacher.
        teacher: policy with actions of the environment.
        settings: rounds, steps, epochs, learning rate.
        report: called after each step with the number of environment steps.
    """
    optimiser = torch.optim.Adam(model.policy.parameters(), lr=settings.learning_rate)
    rounds: list[tuple[Floats, Floats, Floats]] = []
    for number in range(settings.rounds):
        rounds.append(_gather(model, env, teacher, max(settings.steps // env.num_envs, 1), number == 0, report))
        features, actions = (torch.as_tensor(np.concatenate([each[k] for each in rounds])) for k in (0, 1))
        latest, _, returns = map(torch.as_tensor, rounds[-1])  # the critic learns the return of the latest behaviour
        policy = model.policy
        policy.set_training_mode(True)
        for _ in range(settings.epochs):
            for rows in torch.split(torch.randperm(len(features)), MINIBATCH):
                others = torch.randint(len(latest), (MINIBATCH,))
                gaussian = policy.get_distribution(features[rows]).distribution
                assert isinstance(gaussian, torch.distributions.Normal)
                value = policy.predict_values(latest[others]).ravel()
                critic = torch.nn.functional.smooth_l1_loss(value, returns[others])
                loss = ((gaussian.mean - actions[rows]) ** 2).mean() + critic
                optimiser.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
        policy.set_training_mode(False)


def _gather(
    model: PPO, env: ViewVecEnv, teacher: Policy, steps: int, teacher_acts: bool, report: Callable[[int], Any]
) -> tuple[Floats, Floats, Floats]:
    """Features (n, f), the teacher's actions (n, 2) and discounted returns (n,) of one round."""
    features = np.asarray(env.reset())
    state, start = None, np.ones(env.num_envs, dtype=bool)
    inputs, labels, rewards, dones = [], [], [], []
    for _ in range(steps):
        action, state = teacher.predict(env.rows, state, start, deterministic=True)
        inputs.append(features)
        labels.append(env.view.agent_actions(env.config, action))
        applied = labels[-1] if teacher_acts else model.predict(features, deterministic=True)[0]
        new, reward, start, _ = env.step(applied)
        features = np.asarray(new)
        rewards.append(reward)
        dones.append(start)
        report(env.num_envs)
    with torch.no_grad():
        following = model.policy.predict_values(torch.as_tensor(features)).numpy().ravel()
    returns = np.zeros((steps, env.num_envs), dtype=np.float32)
    for k in reversed(range(steps)):
        following = rewards[k] + model.gamma * following * ~dones[k]
        returns[k] = following
    return np.concatenate(inputs), np.concatenate(labels), returns.ravel()


def save_checkpoint(model: PPO, rows: list[dict[str, Any]], path: Path) -> None:
    """Write weights, optimiser, step count and learning curve atomically, after their SHA-256.

    Tensors and plain data only: SB3's files hold pickles, which run code when they are loaded.
    """
    state = {"parameters": model.get_parameters(), "rows": rows, "steps": model.num_timesteps}
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_atomically(path, hashlib.sha256(buffer.getvalue()).digest() + buffer.getvalue())


def restore(model: PPO, path: Path) -> list[dict[str, Any]]:
    """Load the state of a checkpoint; returns the learning curve so far, empty without a checkpoint.

    Raises:
        FileError: the checkpoint is damaged or of another run. No code in it is run.
    """
    if not path.exists():
        return []
    try:
        content = read_bytes(path, MAX_CHECKPOINT)
        if hashlib.sha256(content[DIGEST:]).digest() != content[:DIGEST]:
            raise ValueError("its checksum does not fit: it was changed or cut off")
        state = torch.load(io.BytesIO(content[DIGEST:]), weights_only=True, map_location="cpu")
        rows: list[dict[str, Any]] = state["rows"]
        if any(row["seed"] != model.seed for row in rows) or rows[-1]["steps"] != state["steps"]:
            raise ValueError(f"its learning curve is not of seed {model.seed} and {state['steps']} steps")
        model.set_parameters(state["parameters"])
        if not all(bool(value.isfinite().all()) for value in model.policy.state_dict().values()):
            raise ValueError("weights that are not finite")
        model.num_timesteps = state["steps"]
    except FileError:
        raise
    except Exception as error:  # a damaged file can raise any error in torch or SB3
        reason = f"{type(error).__name__}: {one_line(str(error))[:200]}"
        hint = "restore the file, or choose another folder and train again"
        raise FileError(path, f"not a complete checkpoint of this run ({reason}) - {hint}") from error
    return rows


def print_curves(curves: pd.DataFrame) -> None:
    """Print the phases of all seeds."""
    titles = {"inspection_time_s": "time [s]", "share_within_limit": "within the limit", "wall_s": "wall [s]"}
    names = {name: name for name in ("seed", "phase", "steps", "reward")} | titles
    rows = ([f"{value:.4g}" for value in row] for row in curves[list(names)].itertuples(index=False))
    print_table("Validation after each phase", list(names.values()), rows, left=0)
