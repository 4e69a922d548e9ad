"""The best constant feed and the best open-loop schedule, found on training contexts by CMA-ES.

Both are schedules over the inserted length, so they are stored and evaluated as any other: in ``agents/data/`` with
every trial and how they were made.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import optuna
import pandas as pd
from optuna.samplers import CmaEsSampler
from tqdm import tqdm

from agents.evaluate import Plan, run_plan
from agents.policies import Scheduled
from agents.provenance import provenance, write_atomically, write_json
from probe_env import Fidelity, load_contexts
from probe_env.schedule import Schedule
from probe_env.task import TaskConfig

KNOTS: Final = (5.0, 15.0, 25.0, 35.0, 60.0)  # [m] inserted length
AIR_KNOTS: Final = (5.0, 60.0)
SEARCH_FIDELITY: Final = Fidelity(time_lapse=8.0)
POPULATION: Final = 8


@dataclass(frozen=True)
class Family:
    """A family of schedules: logarithms of feed speed at some lengths and air supply at some, each in [0, 1]."""

    knots: tuple[float, ...]
    air_knots: tuple[float, ...]
    start: tuple[float, ...]

    def schedule(self, x: list[float], config: TaskConfig) -> Schedule:
        """The schedule of a point of the search space."""
        low, high = np.log(config.feed_speeds)
        feed = np.exp(low + np.array(x[: len(self.knots)]) * (high - low))
        least, most = config.air_supply_rates
        air = least + np.array(x[len(self.knots) :]) * (most - least)
        places = KNOTS if len(self.knots) > 1 else self.knots
        airs = np.interp(places, self.air_knots, air)
        return Schedule("inserted_length", "linear", tuple(places), tuple(map(float, feed)), tuple(map(float, airs)))


FAMILIES: Final[dict[str, Family]] = {
    "best-constant": Family((5.0,), (5.0,), (0.55, 0.7)),
    "best-schedule": Family(KNOTS, AIR_KNOTS, (0.95, 0.8, 0.6, 0.5, 0.45, 0.6, 0.8)),
}


def run_search(family_name: str, trials: int, contexts: int, output: Path, work: Path) -> Schedule:
    """Search a family; stores NAME.csv (the schedule), NAME-trials.csv and NAME.json in ``output``.

    Trials and episodes are kept in ``work``, so an interrupted search goes on.

    Raises:
        ValueError: no such family, or a budget out of range.
    """
    if family_name not in FAMILIES:
        raise ValueError(f"family = {family_name!r} is not one of {', '.join(FAMILIES)}")
    train = load_contexts("train")
    if not 1 <= contexts <= len(train):
        raise ValueError(f"contexts = {contexts!r} is outside the accepted range 1 to {len(train)}")
    if trials < 1:
        raise ValueError(f"trials = {trials!r} is outside the accepted range 1 and more")
    family, config = FAMILIES[family_name], TaskConfig()
    chosen = train[:: len(train) // contexts][:contexts]
    work.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    names = [f"x{k}" for k in range(len(family.start))]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # experimental, and to be renamed in Optuna 6
        sampler = CmaEsSampler(x0=dict(zip(names, family.start, strict=True)), sigma0=0.2, popsize=POPULATION, seed=0)
    study = optuna.create_study(
        storage=f"sqlite:///{work / family_name}.db", study_name=family_name, load_if_exists=True,
        direction="maximize", sampler=sampler,
    )  # fmt: skip
    done = len(study.get_trials(states=[optuna.trial.TrialState.COMPLETE]))
    with tqdm(total=trials, initial=done, desc=family_name, unit="trial") as bar:
        while done < trials:
            asked = [study.ask() for _ in range(min(POPULATION, trials - done))]
            points = [[trial.suggest_float(name, 0.0, 1.0) for name in names] for trial in asked]
            for trial, value in zip(asked, _values(family, points, config, chosen, work), strict=True):
                study.tell(trial, value)
            done += len(asked)
            bar.update(len(asked))
    best = family.schedule([study.best_params[name] for name in names], config)
    table = pd.DataFrame([{**t.params, "reward": t.value} for t in study.trials if t.value is not None])
    write_atomically(output / f"{family_name}-trials.csv", table.to_csv(index=False, float_format="%.5g"))
    write_atomically(output / f"{family_name}.csv", best.to_csv())
    setting = {"fidelity": SEARCH_FIDELITY.model_dump(), "contexts": len(chosen), "trials": done}
    write_json(output / f"{family_name}.json", provenance() | setting | {"reward": study.best_value})
    print(f"{family_name}: reward {study.best_value:.2f} on {len(chosen)} training contexts")
    print(best.to_csv())
    return best


def _values(family: Family, points: list[list[float]], config: TaskConfig, contexts: Any, work: Path) -> list[float]:
    """Mean reward of each point, all in one batch; what an interrupted batch has run is not run again."""
    policies = {f"{k}": Scheduled(config, family.schedule(x, config)) for k, x in enumerate(points)}
    table = run_plan(Plan(policies, contexts, config=config, fidelity=SEARCH_FIDELITY), work / "search", progress=False)
    means = table.groupby("policy")["reward"].mean()
    return [float(means[name]) for name in policies]
