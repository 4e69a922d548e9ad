"""Optimises the PLC laws' constants: CMA-ES on the vibration map, then in simulation; the trim by a grid.

The search on the map is deterministic and takes minutes; an interrupted one starts again.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any, Final

import numpy as np
import pandas as pd

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.statistics import paired_difference
from probe_agents.policies.cases import load_case
from probe_agents.policies.fixed import FixedPolicy
from probe_agents.policies.plc_law import Constants, PlcIntegral, PlcProportional, Trim
from probe_agents.policies.policy import Policy
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import commit, origin, write_json
from probe_agents.studies.builtin import Request, print_frame
from probe_agents.studies.shipped.best_schedules import search
from probe_agents.terminal.tables import print_line
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.envs.task import metre_reward, uninspected_weight
from probe_env.envs.task.scales import RF_FLOOR
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, expected_cost, stored_map
from probe_env.fidelity import resolve_fidelity
from probe_env.physics.closed_forms import sliding_tension

RANGES: Final[dict[str, tuple[float, float]]] = {
    "average": (3.0, 40.0), "onset_length": (10.0, 60.0), "onset_friction": (0.0, 3.0), "onset_diameter": (0.0, 3.0),
    "slow_feed": (0.05, 0.4), "slow_length": (0.0, 2.0), "slow_friction": (0.0, 2.0), "slow_diameter": (0.0, 2.0),
    "quiet": (1e-6, 2e-4), "shift": (0.0, 0.6),
}  # fmt: skip
"""Search range of each constant."""
LOGARITHMIC: Final = ("average", "onset_length", "slow_feed", "quiet")
POPULATION: Final = 10
TRIALS, GENERATIONS, LIMIT = 600, 6, 12
"""Laws on the map, generations in simulation, and training tubes of these."""
WIDE, NEAR = 0.2, 0.05
"""First standard deviation as a share of the ranges: on the map, and in simulation around its result."""

AIMS: Final = (2.5e-5, 3e-5, 3.5e-5, 4.2e-5, 5e-5)
"""Target noise of the trim, as radial rms [m]."""
TIMES: Final = (40.0, 80.0, 160.0)
"""Integral times of the trim [s]."""
UNTRIMMED: Final = "plc-law"
TRIM_LIMIT: Final = 48
START = 5.0
"""Inserted length at the start [m]."""


def constants_at(x: FloatArray) -> Constants:
    """Constants of a point (10,) in the unit cube."""
    values = {}
    for share, (name, (low, high)) in zip(x, RANGES.items(), strict=True):
        values[name] = low * (high / low) ** share if name in LOGARITHMIC else low + share * (high - low)
    return Constants.model_validate({name: float(f"{value:.4g}") for name, value in values.items()})


def point_of(constants: Constants) -> FloatArray:
    """The inverse of ``constants_at``, within the cube."""
    shares = []
    for name, (low, high) in RANGES.items():
        value = getattr(constants, name)
        linear = (value - low) / (high - low)
        shares.append(np.log(value / low) / np.log(high / low) if name in LOGARITHMIC else linear)
    return np.asarray(np.clip(shares, 0.0, 1.0))


def run(request: Request) -> None:
    """Search the ten constants of plc-proportional, then the two of plc-integral; store and print.

    Writes plc-law.json, trimmed-law.json and every trial; stored simulations are not repeated. ``trials`` is the number
    of laws on the map, ``limit`` the number of training tubes in simulation.

    Raises:
        ValueError: the limit is out of range.
    """
    request.reject("tube")
    most = SPLIT_SIZES["train"]
    limit, trim_limit = request.budget("limit", LIMIT, most), request.budget("limit", TRIM_LIMIT, most)
    search_law(TRIALS if request.trials is None else request.trials, GENERATIONS, limit, request)
    search_trim(trim_limit, request)
    print_line(f"written: {request.output}/ (plc-law.json, trimmed-law.json, the trials of both)")


def search_law(trials: int, generations: int, limit: int, request: Request) -> Constants:
    """The constants of plc-proportional: on the map, then ``generations`` of ``POPULATION`` laws in simulation."""
    vibration, output = stored_map(), request.output
    whole, case = load_case(None, "train"), load_case(None, "train", limit)
    config = whole.config.full_observation
    rows: list[dict[str, Any]] = []
    commits, done = [commit()], 0  # of the laws on the map, which are not stored

    def by_map(points: FloatArray) -> list[float]:
        laws = [PlcProportional(config, constants_at(point)) for point in points]
        return [float(quasi_steady_rewards(law, whole.contexts, vibration).mean()) for law in laws]

    def simulated(points: FloatArray) -> list[float]:
        nonlocal done
        policies = {f"law-{done + k}": PlcProportional(config, constants_at(point)) for k, point in enumerate(points)}
        plan = Plan(policies, case.contexts, config=config, fidelity=resolve_fidelity("fast", config.scene))
        table = run_plan(plan, output / "episodes" / f"{done:04d}", progress=False, workers=request.workers)
        done += len(points)
        commits.extend(table["commit"])
        means = table.groupby("policy")["reward"].mean()
        return [float(means[name]) for name in policies]

    stages = ("map", by_map, WIDE, max(trials // POPULATION, 1)), ("simulated", simulated, NEAR, generations)
    best = Constants()
    for where, reward, spread, count in stages:
        points, rewards, mean = search(reward, point_of(best), count, f"plc-law, {where}", spread, POPULATION)
        centre = np.clip(mean, 0.0, 1.0)
        laws, gained = [*map(constants_at, points), constants_at(centre)], [*rewards, *reward(centre[None])]
        rows += [{"where": where, "reward": value, **law.model_dump()} for law, value in zip(laws, gained, strict=True)]
        best = laws[-1] if gained[-1] >= max(gained) else laws[int(np.argmax(gained))]  # the mean if equal
    table = pd.DataFrame(rows)
    write_atomically(output / "plc-law-trials.csv", table.to_csv(index=False, float_format="%.6g"))
    best_rewards = {where: float(part["reward"].max()) for where, part in table.groupby("where", sort=False)}
    tubes = {"map": len(whole.contexts), "simulated": limit}
    record = {"constants": best.model_dump(), "rewards": best_rewards, "tubes": tubes}
    write_json(output / "plc-law.json", record | {"provenance": origin(commits=commits)})
    return best


def search_trim(limit: int, request: Request) -> Trim:
    """The constants of plc-integral: a grid of aims and times, compared with plc-proportional."""
    case = load_case(None, "train", limit)
    config = case.config.full_observation
    trims = {f"trim-{k}": Trim(aim=aim, time=time) for k, (aim, time) in enumerate(product(AIMS, TIMES))}
    policies: dict[str, Policy] = {UNTRIMMED: PlcProportional(config)}
    policies |= {name: PlcIntegral(config, trim=trim) for name, trim in trims.items()}
    plan = Plan(policies, case.contexts, config=config, fidelity=resolve_fidelity("fast", config.scene))
    table = run_plan(plan, request.output / "trim-episodes", workers=request.workers)
    rows: list[dict[str, Any]] = []
    for name, trim in trims.items():
        gain = paired_difference(table, name, UNTRIMMED, "reward")
        row = trim.model_dump() | {"reward": table[table["policy"] == name]["reward"].mean()}
        rows.append(row | {"gain": gain.mean, "gain_low": gain.low, "gain_high": gain.high})
    trials = pd.DataFrame(rows)
    best = rows[int(trials["reward"].to_numpy().argmax())]
    chosen = Trim(aim=best["aim"], time=best["time"])
    write_atomically(request.output / "trimmed-law-trials.csv", trials.to_csv(index=False, float_format="%.6g"))
    record = {"trim": chosen.model_dump(), "reward": best["reward"], "gain": best["gain"], "tubes": limit}
    write_json(request.output / "trimmed-law.json", record | {"provenance": origin(commits=table["commit"])})
    print_frame(f"Reward minus that of {UNTRIMMED}, {limit} tubes", trials, texts=0)
    return chosen


def quasi_steady_rewards(policy: FixedPolicy, tubes: Sequence[Context], vibration: VibrationMap) -> FloatArray:
    """Expected reward (n,) of insertions with tension, noise and cost of steady states; without jerk."""
    config = policy.config
    values = np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])
    column = {name: values[:, k] for k, name in enumerate(CONTEXT)}
    count, end, dt = len(tubes), config.scene.tube.helix_length, config.period
    length, reward, noise = np.full(count, START), np.zeros(count), np.full(count, RF_FLOOR)
    feed = np.full(count, config.feed_speeds[1])
    air = np.full(count, config.air_supply_rates[0])
    memory = np.zeros((count, policy.memory))
    policy.start(memory)
    for step in range(round(config.time_limit / dt)):
        observation = {
            "inserted_length": length, "feed_speed": feed, "air_supply_rate": air, "rf_noise": noise,
            "helix_diameter": column["helix_diameter"], "time": np.full(count, step * dt),
        }  # fmt: skip
        tension = sliding_tension(column["friction"], observation, config.scene) * column["drag_factor"]
        feed, air = policy.targets(observation | {"root_tension": tension}, memory)
        left = np.maximum(end - length, 0.0)
        travel = np.minimum(feed * dt, left)
        mean, deviation = vibration.predict(length + 0.5 * travel, feed, air, values, config.scene)
        noise = np.hypot(10.0**mean * 1e-4, RF_FLOOR)
        reward += travel * metre_reward(config, expected_cost(mean, deviation, feed, air, config))
        length = length + travel
        if (left <= 0.0).all():
            break
    return reward - uninspected_weight(config) * np.maximum(end - length, 0.0)
