"""Trains the README's recipe with five seeds and writes its learning curve: results/learning/NAME/curve.csv.

Usage: python docs/learning.py surrogate|fast [--seeds 0 1 2 3 4] [--steps 50000 200000 1000000 3000000]
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from pathlib import Path

import pandas as pd
import torch
from stable_baselines3 import PPO

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.policies.bundle import from_sb3
from probe_agents.policies.catalogue import named_policies
from probe_agents.records.manifest import write_manifest
from probe_agents.vec_env import ProbeVecEnv
from probe_env import TaskConfig, load_contexts
from probe_env.fidelity import resolve_fidelity

FOLDER = Path(__file__).parents[1] / "results" / "learning"
ID, NUM_ENVS = "probe_env/IncrementalInsertion-v1", 64
RIVALS = ("constant", "pi", "best-schedule", "plc-integral")
COLUMNS = ["policy", "reward", "inspection_time_s", "share_within_limit", "lost_drive"]
TUBES = 24
"""Number of test tubes."""


def train(fidelity: str, seed: int, steps: tuple[int, ...], folder: Path) -> list[float]:
    """Train a seed and save the model after each number of steps; seconds of training until each."""
    torch.set_num_threads(1)
    env = ProbeVecEnv(ID, NUM_ENVS, fidelity=fidelity, contexts="train")
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=256, device="cpu", seed=seed)
    begin, seconds = time.perf_counter(), []
    for total in steps:
        model.learn(total - model.num_timesteps, reset_num_timesteps=False)
        seconds.append(time.perf_counter() - begin)
        model.save(folder / f"{fidelity}-{seed}-{total}")
        print(f"{fidelity}, seed {seed}: {total} steps, {seconds[-1]:.0f} s", flush=True)
    return seconds


def curve(fidelity: str, seeds: tuple[int, ...], steps: tuple[int, ...], folder: Path) -> pd.DataFrame:
    """Means over ``TUBES`` test tubes at ``fast`` of every seed and number of steps, and of ``RIVALS``."""
    folder.mkdir(parents=True, exist_ok=True)
    jobs = 2 if fidelity == "surrogate" else 1  # the simulation has threads
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        seconds = pool.starmap(train, [(fidelity, seed, steps, folder) for seed in seeds], chunksize=1)
    config, trained = TaskConfig(), ProbeVecEnv(ID, 1, fidelity="surrogate").config
    rows = pd.DataFrame(
        {"policy": f"{seed} {total}", "seed": seed, "steps": total, "seconds": times[k]}
        for seed, times in zip(seeds, seconds, strict=True)
        for k, total in enumerate(steps)
    )
    models = {name: PPO.load(folder / f"{fidelity}-{name.replace(' ', '-')}", device="cpu") for name in rows["policy"]}
    policies = named_policies(RIVALS, config.full_observation)
    policies |= {name: from_sb3(model, trained) for name, model in models.items()}
    plan = Plan(
        policies, load_contexts("test")[:TUBES], (0,), config.full_observation, resolve_fidelity("fast", config.scene)
    )
    table = run_plan(plan, None, batch=64)[COLUMNS].groupby("policy", sort=False).mean().reset_index()
    return table.merge(rows, how="left", on="policy")


def table() -> str:
    """The README's table of the recipe in the surrogate, from the stored curve."""
    rows = pd.read_csv(FOLDER / "surrogate" / "curve.csv")
    rivals, trained = rows[rows["seed"].isna()].set_index("policy")["reward"], rows[rows["seed"].notna()]
    lines = ["| steps | reward, mean of five seeds | lowest and highest seed |", "|---:|---:|---:|"]
    for steps, seeds in trained.groupby("steps"):
        reward = seeds["reward"]
        lines.append(f"| {steps:,.0f} | {reward.mean():.1f} | {reward.min():.1f} to {reward.max():.1f} |")
    others = ", ".join(f"`{name}` {rivals[name]:.1f}" for name in RIVALS)
    return "\n".join([*lines, "", f"In the same {TUBES} tubes: {others}."])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("fidelity", choices=("surrogate", "fast"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--steps", type=int, nargs="+", default=[50_000, 200_000, 1_000_000, 3_000_000])
    parser.add_argument("--models", type=Path, default=Path("output/learning"), help="folder of the models")
    arguments = parser.parse_args()
    result = curve(arguments.fidelity, tuple(arguments.seeds), tuple(arguments.steps), arguments.models)
    folder = FOLDER / arguments.fidelity
    folder.mkdir(parents=True, exist_ok=True)
    result.to_csv(folder / "curve.csv", index=False, float_format="%.6g")
    settings = (f"--{name} {' '.join(map(str, getattr(arguments, name)))}" for name in ("seeds", "steps"))
    command = f"python docs/learning.py {arguments.fidelity} {' '.join(settings)}"
    write_manifest(folder, ("curve.csv",), command=command, seeds=tuple(arguments.seeds))
    print(result.to_string())
