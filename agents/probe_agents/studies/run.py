"""Runs a study: a plan for every setting, and one table of episodes with a column for every varied field."""

import hashlib
import json
import re
import warnings
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd

from probe_agents.evaluation.plan import BATCH, Plan, run_plan
from probe_agents.evaluation.statistics import grouped
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.cases import EvaluationCase, load_case, map_of, plant_at, with_probe
from probe_agents.policies.catalogue import named_policies
from probe_agents.policies.fixed import Scheduled
from probe_agents.policies.law import LawPolicy
from probe_agents.policies.policy import OutsideDomain, Policy
from probe_agents.policies.wrappers import RoundTripPolicy
from probe_agents.studies.spec import Changes, Study
from probe_env import Plant
from probe_env.envs.episodes import Episodes
from probe_env.envs.task.config import TaskConfig
from probe_env.fidelity import Fidelity, resolve_fidelity
from probe_env.machine import available_cores
from probe_env.settings import explain

RECOMMENDED: Final = ("recommended", "recommended-law")
"""Policies that are optimised for the plant of a setting with the calibrated response."""


class Setting(NamedTuple):
    """One setting of a study.

    Attributes:
        values: column -> value of fidelity and varied fields, as simulated.
        plan: policies, tubes, task and fidelity.
        members: policy of the plan -> its columns: ``policy`` and ``policy.PARAMETER``.
        folder: name of the episodes' folder.
    """

    values: Changes
    plan: Plan
    members: dict[str, Changes]
    folder: str


def expand(study: Study) -> list[Setting]:
    """All settings of a study, checked.

    Raises:
        ValueError: names a field, value or policy that is not valid.
        FileNotFoundError: no such plant, probe or schedule.
    """
    settings = [_setting(study, fidelity, changes) for fidelity, changes in study.settings()]
    folders = [setting.folder for setting in settings]
    twice = next((setting for setting in settings if folders.count(setting.folder) > 1), None)
    if twice:
        raise ValueError(f"vary: two settings are equal: {twice.values}")
    return settings


def run_study(settings: list[Setting], output: Path, workers: Workers = HERE) -> pd.DataFrame:
    """Run what is missing in ``output``; returns all episodes with the columns of their settings."""
    tables = []
    for number, setting in enumerate(settings, start=1):
        print(f"{number} of {len(settings)}: {', '.join(f'{k} = {v}' for k, v in setting.values.items())}", flush=True)
        # methods without lanes run few episodes at a time, so that each is stored when it ends
        fidelity = setting.plan.fidelity
        batch = BATCH if not fidelity.simulates or fidelity.numerics[0].width > 1 else available_cores()
        table = run_plan(setting.plan, output / "episodes" / setting.folder, batch=batch, workers=workers)
        columns = pd.DataFrame([setting.members[name] for name in table["policy"]], index=table.index)
        tables.append(pd.concat([columns.assign(**setting.values), table.drop(columns="policy")], axis=1))
    return grouped(pd.concat(tables, ignore_index=True))


def _setting(study: Study, fidelity: str, changes: Changes) -> Setting:
    try:
        tube = Path(study.tube) if study.tube else None
        plant, update = plant_at(tube), _nested("plant", study.set | changes)
        if update:
            plant = (plant or Plant()).model_copy(update=update)
        case = load_case(plant, study.contexts, study.limit, vibration=map_of(tube, plant))
        unvaried = _changed(case.config.full_observation, study.set)
        config = _changed(unvaried, changes)
        accuracy = resolve_fidelity(fidelity, config.scene, config.growing, config.returns)
        if update := _nested("fidelity", study.set | changes):
            accuracy = resolve_fidelity(accuracy.model_copy(update=update), config.scene, round_trip=config.returns)
        policy_config = config if study.policies_know == "varied task" else unvaried
        policies, members = _policies(study, policy_config, case, plant)
        Episodes(1, config, fidelity=accuracy, surrogate_map=case.vibration).check(case.contexts)
    except (ValueError, TypeError) as error:
        where = ", ".join(f"{name} = {value!r}" for name, value in (study.set | changes).items())
        raise ValueError(f"{where}: {explain(error)}" if where else explain(error)) from error
    plan = Plan(policies, case.contexts, study.seeds, config, accuracy, vibration=case.vibration)
    values = {"fidelity": fidelity} | {name: _value(name, changes, config, plan.fidelity) for name in study.varied}
    return Setting(values, plan, members, _folder(values))


def _changed(config: TaskConfig, changes: Changes) -> TaskConfig:
    """The task with the changes of task fields and probe."""
    update = _nested("task", changes) | {root: part for root in ("scene", "sensor") if (part := _nested(root, changes))}
    config = config.model_copy(update=update) if update else config
    probe = changes.get("probe", "scene")
    return config if probe == "scene" else with_probe(config, probe)


def _nested(root: str, changes: Changes) -> dict[str, Any]:
    """Nested mapping of the dotted fields of a root."""
    nested: dict[str, Any] = {}
    for name, value in changes.items():
        first, *rest = name.split(".")
        if first != root or not rest:
            continue
        table = nested
        for part in rest[:-1]:
            table = table.setdefault(part, {})
        table[rest[-1]] = value
    return nested


def _value(name: str, changes: Changes, config: TaskConfig, fidelity: Fidelity) -> Any:
    """Value of a varied field as simulated; of a plant field or a probe as in the study."""
    root, *rest = name.split(".")
    if root in ("plant", "probe"):
        return changes.get(name, "scene" if root == "probe" else None)
    value: Any = {"task": config, "scene": config.scene, "sensor": config.sensor, "fidelity": fidelity}[root]
    for part in rest:
        value = getattr(value, part)
    return ", ".join(map(str, value)) if isinstance(value, tuple) else value


def _policies(
    study: Study, config: TaskConfig, case: EvaluationCase, plant: Plant | None
) -> tuple[dict[str, Policy], dict[str, Changes]]:
    """Policies by their names in the plan, and their columns."""
    policies: dict[str, Policy] = {}
    members: dict[str, Changes] = {}
    for spec, parameters in study.members():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OutsideDomain)  # studies vary beyond the range on purpose
            recommended = {spec: _recommended(spec, config, plant)} if spec in RECOMMENDED else {}
            base = recommended or named_policies([spec], config, case.vibration)
        for name, policy in base.items():
            member = " ".join((name, *(f"{key}={value}" for key, value in parameters.items())))
            if member in policies:
                raise ValueError(f"policies: {member} occurs twice; NAME=FILE sets another name")
            policies[member] = _with_parameters(policy, name, parameters) if parameters else policy
            members[member] = {"policy": name} | {f"policy.{key}": value for key, value in parameters.items()}
    return policies, members


def _with_parameters(policy: Any, name: str, parameters: Mapping[str, Any]) -> Any:
    """A policy with other parameters."""
    if isinstance(policy, RoundTripPolicy):
        return replace(policy, insertion=_with_parameters(policy.insertion, name, parameters))
    all_fields = fields(policy) if is_dataclass(policy) else ()
    accepted = [part.name for part in all_fields if part.name not in ("config", "vibration")]
    for key, value in parameters.items():
        if key not in accepted:
            raise ValueError(f"policies: {name} has no parameter {key!r}; accepted: {', '.join(accepted) or 'none'}")
        now = getattr(policy, key)
        if now is not None and isinstance(now, str) != isinstance(value, str):
            raise ValueError(f"policies: {name}: {key} = {value!r} is of another type than {now!r}")
    return replace(policy, **parameters)


def _recommended(name: str, config: TaskConfig, plant: Plant | None) -> Policy:
    """The policy that the calibrated response recommends for a plant, optimised on training tubes."""
    from probe_agents.plant.recommendation import optimal_law, optimal_schedule
    from probe_agents.plant.response import stored_response

    tubes, response = load_case(plant, "train").contexts, stored_response()
    if name == "recommended":
        return Scheduled(config, optimal_schedule(tubes, response, config).schedule)
    return LawPolicy(config, law=optimal_law(tubes, response, config))


def _folder(values: Changes) -> str:
    """Name of a folder: the values, and a digest that is unique."""
    text = "-".join(f"{name.rpartition('.')[2]}-{value}" for name, value in values.items())
    digest = hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:8]
    return f"{re.sub(r'[^A-Za-z0-9_.+-]+', '-', text)[:80].strip('-.')}-{digest}"
