"""The best constant feed and the best open-loop schedules for the training tubes, by CMA-ES on the vibration map.

All are schedules over the inserted length, so they are stored and evaluated as any other: in ``agents/data/`` with
every trial and how they were made. The map stands in for the simulator in the search; what is found is simulated on
the validation tubes.
"""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import optuna
import pandas as pd
from optuna.samplers import CmaEsSampler
from tqdm import tqdm

from agents.evaluate import Plan, run_plan
from agents.map_policies import LEAST_AIR
from agents.policies import Scheduled
from agents.provenance import provenance, write_atomically, write_json
from agents.vibration_map import CONTEXT, FEEDS, features_of, metre_cost, stored_map
from agents.vibration_map import STORED as MAP_FILE
from agents.work import Work, announce
from probe_env import Context, load_contexts
from probe_env.chain import FloatArray
from probe_env.contexts import HELIX_DIAMETERS
from probe_env.fidelity import PRESETS
from probe_env.schedule import Schedule
from probe_env.task import TaskConfig

KNOTS: Final = (5.0, 12.0, 19.0, 26.0, 33.0, 42.0, 60.0)  # [m] inserted length
AIR_KNOTS: Final = (5.0, 19.0, 26.0, 33.0, 60.0)
METRES: Final = np.arange(5.5, 60.0, 1.0)
POPULATION: Final = 16
BATCH: Final = 16


@dataclass(frozen=True)
class Family:
    """A family of schedules: logarithms of feed speed at some lengths and air supply at some, each in [0, 1].

    Attributes:
        knots, air_knots: lengths [m]; a single one is a constant.
        start: where the search begins.
        helix_diameter: of the tubes that it is for [m]; None: all.
    """

    knots: tuple[float, ...]
    air_knots: tuple[float, ...]
    start: tuple[float, ...]
    helix_diameter: float | None = None

    def schedule(self, x: list[float], config: TaskConfig) -> Schedule:
        """The schedule of a point of the search space."""
        low, high = np.log(FEEDS)
        feed = np.exp(low + np.array(x[: len(self.knots)]) * (high - low))
        air = LEAST_AIR + np.array(x[len(self.knots) :]) * (config.air_supply_rates[1] - LEAST_AIR)
        places = sorted({*self.knots, *self.air_knots})
        feeds, airs = np.interp(places, self.knots, feed), np.interp(places, self.air_knots, air)
        return Schedule("inserted_length", "linear", tuple(places), tuple(map(float, feeds)), tuple(map(float, airs)))

    def tubes(self, contexts: tuple[Context, ...]) -> tuple[Context, ...]:
        """Those of the contexts that it is for."""
        return tuple(c for c in contexts if self.helix_diameter in (None, c.helix_diameter))


def _schedule_family(helix_diameter: float | None = None) -> Family:
    return Family(KNOTS, AIR_KNOTS, (0.95, 0.9, 0.6, 0.6, 0.55, 0.45, 0.35, 0.2, 0.5, 0.9, 0.95, 0.95), helix_diameter)


FAMILIES: Final[dict[str, Family]] = {
    "best-constant": Family((5.0,), (5.0,), (0.45, 0.7)),
    "best-schedule": _schedule_family(),
    **{f"best-schedule-d{d:g}": _schedule_family(d) for d in HELIX_DIAMETERS},
}


@dataclass(frozen=True)
class MapCost:
    """Expected cost of schedules on tubes by the map, and so their reward."""

    tubes: tuple[Context, ...]
    config: TaskConfig

    @cached_property
    def _tiled(self) -> tuple[FloatArray, FloatArray]:
        values = np.array([[getattr(c, name) for name in CONTEXT] for c in self.tubes])
        return np.tile(METRES, len(values)), np.repeat(values, len(METRES), axis=0)

    def reward(self, schedule: Schedule) -> float:
        """Mean reward of a whole insertion; what is not in the map (jerk, lost drive) is left out."""
        lengths, tubes = self._tiled
        feed, air = schedule.at(lengths)
        cost = metre_cost(*stored_map().distribution(features_of(lengths, feed, air, tubes)), feed, air, self.config)
        return float(len(METRES) * (self.config.progress_weight - cost.mean()))


def run_search(family_name: str, trials: int, output: Path, work: Path, simulate: bool = True) -> Schedule:
    """Search a family; stores NAME.csv (the schedule), NAME-trials.csv and NAME.json in ``output``.

    Trials and episodes are kept in ``work``, so an interrupted search goes on.

    Raises:
        ValueError: no such family, or a budget out of range.
    """
    if family_name not in FAMILIES:
        raise ValueError(f"family = {family_name!r} is not one of {', '.join(FAMILIES)}")
    if trials < 1:
        raise ValueError(f"trials = {trials!r} is outside the accepted range 1 and more")
    family, config = FAMILIES[family_name], TaskConfig()
    cost = MapCost(family.tubes(load_contexts("train")), config)
    work.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    names = [f"x{k}" for k in range(len(family.start))]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # experimental, and to be renamed in Optuna 6
        sampler = CmaEsSampler(
            x0=dict(zip(names, family.start, strict=True)),
            sigma0=0.2,
            popsize=POPULATION,
            seed=0,
            warn_independent_sampling=False,
        )
    problem = hashlib.sha256(repr((family, config, cost.tubes)).encode() + MAP_FILE.read_bytes()).hexdigest()[:12]
    study = optuna.create_study(
        storage=f"sqlite:///{work / family_name}.db", study_name=f"{family_name}-{problem}", load_if_exists=True,
        direction="maximize", sampler=sampler,
    )  # fmt: skip

    def complete() -> int:
        return len(study.get_trials(deepcopy=False, states=[optuna.trial.TrialState.COMPLETE]))

    done = complete()
    announce(Work("trial", trials, complete, work / f"{family_name}.db"))
    with tqdm(total=trials, initial=min(done, trials), desc=family_name, unit="trial") as bar:
        for _ in range(done, trials):
            trial = study.ask()
            point = [trial.suggest_float(name, 0.0, 1.0) for name in names]
            study.tell(trial, cost.reward(family.schedule(point, config)))
            bar.update()
    best = family.schedule([study.best_params[name] for name in names], config)
    table = pd.DataFrame([{**t.params, "reward": t.value} for t in study.trials if t.value is not None])
    setting = {"training_tubes": len(cost.tubes), "trials": len(table), "reward_by_map": study.best_value}
    if simulate:
        tubes = family.tubes(load_contexts("validation"))
        plan = Plan({family_name: Scheduled(config, best)}, tubes, config=config, fidelity=PRESETS["fast"])
        simulated = run_plan(plan, work / "simulated" / family_name)
        setting |= {"validation_tubes": len(tubes), "reward_simulated": float(simulated["reward"].mean())}
    write_atomically(output / f"{family_name}-trials.csv", table.to_csv(index=False, float_format="%.4g"))
    write_atomically(output / f"{family_name}.csv", best.to_csv())
    write_json(output / f"{family_name}.json", provenance() | setting)
    print(f"{family_name}: " + ", ".join(f"{name} {value:.4g}" for name, value in setting.items()))
    print(best.to_csv())
    return best
