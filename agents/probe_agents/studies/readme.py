"""Measured figures of the README: learning curves of its recipe, environment steps per second.

``python -m probe_agents.studies.readme`` prints its tables from the stored results; a test compares them.
"""

import json
import multiprocessing
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.catalogue import named_policies
from probe_agents.records.manifest import CHECKOUT, commit, write_json, write_manifest
from probe_agents.records.store import write_tables
from probe_agents.terminal.tables import print_terms
from probe_env import TaskConfig, load_contexts
from probe_env.fidelity import resolve_fidelity

RESULTS: Final = CHECKOUT / "results"
POLICIES: Final = {
    "constant": "0.2 m/s and 63 m³/h, as in the study",
    "pi": "PI control of the measured vibration",
    "best-schedule": "best schedule over length for all training tubes",
    "tension-scheduled": "best schedule on the vibration map for the friction estimated from the root tension",
    "plc-integral": "PLC law with integral action: length, root tension and noise in, feed and air out",
    "ppo": "PPO, five training seeds",
}
COLUMNS: Final = {
    "reward": ("reward", 1.0, ".1f"),
    "time [s]": ("inspection_time_s", 1.0, ".0f"),
    "within the limit [%]": ("share_within_limit", 100.0, ".1f"),
    "radial rms [mm]": ("radial_rms_m", 1e3, ".3f"),
    "air [m³]": ("air_m3", 1.0, ".1f"),
}
"""Header -> KPI, factor, format."""


class Recipe(NamedTuple):
    """An algorithm of Stable-Baselines3 in the surrogate with 64 environments.

    ``settings`` are those of ``model``; ``tuning`` is the number of trainings spent on choosing them.
    """

    algorithm: str
    settings: dict[str, Any]
    seeds: int
    steps: tuple[int, ...]
    tuning: int = 0


RECIPES: Final = {
    "ppo": Recipe("PPO", {"n_steps": 32, "batch_size": 256}, 5, (50_000, 200_000)),
    "sac": Recipe("SAC", {}, 3, (50_000, 200_000)),
    "sac-tuned": Recipe("SAC", {"gradient_steps": 4}, 3, (50_000, 200_000), tuning=2),
}
"""Name -> recipe. PPO: rollouts of 2,048 steps as in Stable-Baselines3; batches of 256 save time."""
ENV: Final = "probe_env/IncrementalInsertion-v1"
RIVALS: Final = ("constant", "pi", "best-schedule", "plc-integral")
SPEEDS: Final = (("fast", 1, 60), ("fast", 16, 60), ("fast", 64, 40), ("surrogate", 64, 300))
"""Fidelity, number of environments, steps of a run."""
RUNS: Final = 5


def results_table(results: Path = RESULTS) -> str:
    """The README's results in Markdown; a method with several training seeds NAME@K has their mean."""
    summary = pd.read_csv(results / "evaluation" / "summary.csv")
    summary["policy"] = summary["policy"].str.replace(r"@\d+$", "", regex=True)
    means = summary.groupby(["policy", "kpi"])["mean"].mean()
    lines = [f"| policy | description | {' | '.join(COLUMNS)} |", "|---|---|" + "---:|" * len(COLUMNS)]
    for name, description in POLICIES.items():
        cells = (f"{means[name, kpi] * factor:{style}}" for kpi, factor, style in COLUMNS.values())
        lines.append(f"| `{name}` | {description} | {' | '.join(cells)} |")
    return "\n".join(lines)


def learning_table(results: Path = RESULTS) -> str:
    """The README's table of the recipes that were not tuned, in Markdown: mean (lowest to highest seed)."""
    rows = pd.read_csv(results / "learning" / "curve.csv")
    rivals = rows[rows["recipe"].isna()].set_index("policy")["reward"]
    steps = sorted(rows["steps"].dropna().unique())
    lines = [
        f"| algorithm | seeds | {' | '.join(f'{n:,.0f} steps' for n in steps)} |",
        "|---|---:|" + "---:|" * len(steps),
    ]
    for name, recipe in RECIPES.items():
        if recipe.tuning:
            continue
        trained = rows[rows["recipe"] == name]
        rewards = (trained.loc[trained["steps"] == n, "reward"] for n in steps)
        cells = (f"{reward.mean():.1f} ({reward.min():.1f} to {reward.max():.1f})" for reward in rewards)
        settings = "".join(f", `{key}={value}`" for key, value in recipe.settings.items())
        lines.append(f"| {recipe.algorithm}{settings} | {trained['seed'].nunique()} | {' | '.join(cells)} |")
    others = ", ".join(f"`{name}` {rivals[name]:.1f}" for name in RIVALS)
    return "\n".join([*lines, "", f"In the same 24 tubes: {others}."])


def speed_row(results: Path = RESULTS) -> str:
    """The README's row of speeds in Markdown, medians to two digits."""
    stored = json.loads((results / "bench" / "speed.json").read_text())
    one, sixteen, many, surrogate = (f"{float(f'{np.median(runs):.2g}'):,.0f}" for runs in stored.values())
    return (
        "| speed | environment steps per second on two cores in the first minute of an insertion:"
        f" {one} at `fast` with one probe, {sixteen} with 16,"
        f" {many} with 64; {surrogate} in the `surrogate` with 64 |"
    )


def learn(output: Path, limit: int = 24, trials: int = 5, workers: Workers = HERE) -> pd.DataFrame:
    """Train ``RECIPES`` with at most ``trials`` seeds each and test them at ``fast``; writes curve.csv and the models.

    Seeds whose models are stored are not trained again. curve.csv has means over the test tubes of every recipe, seed
    and number of steps, and of ``RIVALS``.
    """
    from probe_agents.policies import load_bundle

    config, runs = TaskConfig().full_observation, []
    for name, recipe in RECIPES.items():
        runs += [(name, recipe, seed, output / "models") for seed in range(min(recipe.seeds, trials))]
    (output / "models").mkdir(parents=True, exist_ok=True)
    with multiprocessing.get_context("spawn").Pool(workers.jobs) as pool:
        trained = pd.concat(pool.starmap(train, runs, chunksize=1), ignore_index=True)
    policies = named_policies(RIVALS, config) | {
        name: load_bundle(output / "models" / f"{name}.safetensors", config) for name in trained["policy"]
    }
    plan = Plan(policies, load_contexts("test")[:limit], (0,), config, resolve_fidelity("fast", config.scene))
    means = run_plan(plan, None, batch=64).groupby("policy", sort=False)
    figures = means[["reward", "inspection_time_s", "share_within_limit", "lost_drive"]].mean().reset_index()
    table = figures.merge(trained, how="left", on="policy")
    commits = [*trained["commit"], commit()]
    write_manifest(output, write_tables(output, {"curve": table}), seeds=range(trials), commits=commits)
    print(table.to_string())
    return table


def train(name: str, recipe: Recipe, seed: int, folder: Path) -> pd.DataFrame:
    """Train a seed of a recipe; saves a bundle NAME-SEED-STEPS after each number of steps, with the time until then."""
    stored = folder / f"{name}-{seed}.csv"
    if stored.exists():
        return pd.read_csv(stored)
    import stable_baselines3
    import torch

    from probe_agents.policies import save_bundle
    from probe_agents.vec_env import ProbeVecEnv

    torch.set_num_threads(1)
    env = ProbeVecEnv(ENV, 64, fidelity="surrogate", contexts="train")
    model = getattr(stable_baselines3, recipe.algorithm)("MlpPolicy", env, device="cpu", seed=seed, **recipe.settings)
    begin, rows = time.perf_counter(), []
    for steps in recipe.steps:
        model.learn(steps - model.num_timesteps, reset_num_timesteps=False)
        row = {"recipe": name, "seed": seed, "steps": steps, "seconds": time.perf_counter() - begin}
        rows.append({"policy": f"{name}-{seed}-{steps}", **row, "tuning": recipe.tuning, "commit": commit()})
        save_bundle(folder / f"{rows[-1]['policy']}.safetensors", model, env.config)
        print(f"{rows[-1]['policy']}: {row['seconds']:.0f} s", flush=True)
    pd.DataFrame(rows).to_csv(stored, index=False)
    return pd.read_csv(stored)


def measure_speed(output: Path, workers: Workers = HERE) -> dict[str, list[float]]:
    """Measure environment steps per second in ``RUNS`` runs of ``SPEEDS``; writes speed.json."""
    runs = [[steps_per_second(*case) for case in SPEEDS] for _ in range(RUNS)]
    measured = {f"{fidelity}, {n}": [run[k] for run in runs] for k, (fidelity, n, _) in enumerate(SPEEDS)}
    write_json(output / "speed.json", measured)
    write_manifest(output, ("speed.json",), seeds=(0,))
    print_terms({name: f"{np.median(speeds):,.0f} environment steps per second" for name, speeds in measured.items()})
    return measured


def steps_per_second(fidelity: str, count: int, steps: int) -> float:
    """Steps of all environments per second from the start of an insertion, after one step that compiles."""
    env = gym.make_vec("probe_env/Insertion-v1", num_envs=count, fidelity=fidelity, contexts="train")
    env.reset(seed=0)
    actions = np.zeros((count, 2), dtype=np.float32)
    env.step(actions)
    begin = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    return count * steps / (time.perf_counter() - begin)


if __name__ == "__main__":
    print(results_table(), learning_table(), speed_row(), sep="\n\n")
