"""Policies by name or file: built-in ones, stored schedules, trained agents, and files of the user."""

import difflib
import re
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Final

from probe_agents.policies.fixed import BUILT_IN, Replayed, Scheduled
from probe_agents.policies.law import Law, LawPolicy
from probe_agents.policies.on_map import MAP_POLICIES, ByDiameter
from probe_agents.policies.planner import PLANNERS, InsertionPlanner
from probe_agents.policies.plc_law import PlcIntegral, PlcProportional, read_constants
from probe_agents.policies.policy import MAX_JSON, Domain, Policy
from probe_agents.policies.wrappers import PREFIX, RoundTripPolicy, Shielded, fastest_withdrawal, insertion_task
from probe_agents.records.reader import read_schedule, read_withdrawal
from probe_agents.records.shipped import policy_file, shipped_agents, shipped_names, ships
from probe_agents.records.sources import WORKBOOKS, file_and_sheet
from probe_agents.terminal.names import checked_name, name_of
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.vibration_map import VibrationMap, check_measure, stored_map
from probe_env.files import one_line, read_text
from probe_env.schedule import Schedule

SCHEDULES: Final = (".csv", ".toml", *WORKBOOKS)
FILES: Final = (*SCHEDULES, ".json", ".safetensors")
DATA: Final = Path(__file__).parent / "data"
STORED: Final = ("best-constant", "best-schedule")
"""Schedules found by ``probe-env study best-schedules``, in ``agents/probe_agents/policies/data/``."""
LAWS: Final[dict[str, type[PlcProportional]]] = {"plc-proportional": PlcProportional, "plc-integral": PlcIntegral}
BY_DIAMETER: Final = "best-schedule-by-diameter"
NAMES: Final = (*BUILT_IN, *STORED, BY_DIAMETER, *MAP_POLICIES, *LAWS, *PLANNERS)
CLASS: Final = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)")
"""A policy class of the user: importable module, class name."""
REPLACED: Final = {
    "ppo-any-probe": "adaptive", "planner-blurred": "planner-averaged", "planner-estimated": "planner-inferred",
    "both-ways": "fast-in", "best-both-ways": "fast-in",
}  # fmt: skip
"""Removed policies and what replaced them."""


def named_policies(
    specs: Sequence[str], config: TaskConfig, vibration: VibrationMap | None = None, classes: bool = False
) -> dict[str, Policy]:
    """Make policies from "NAME=SPEC" or "SPEC"; the keys are their names in tables."""
    pairs = [name_and_spec(spec) for spec in specs]
    names = [name for name, _ in pairs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not names:
        raise ValueError(
            f"policies = {', '.join(specs) or 'none'}: at least one is needed, and names must differ"
            + (f" ({', '.join(twice)}); NAME=FILE gives a name" if twice else "")
        )
    return {
        checked_name(name, "policy", "NAME=FILE gives a name"): make_policy(spec, config, vibration, classes)
        for name, spec in pairs
    }


def name_and_spec(argument: str) -> tuple[str, str]:
    """Split a policy argument into name and spec; an existing file has priority, even with "=" in its name."""
    if argument.startswith(PREFIX):
        name, spec = name_and_spec(argument.removeprefix(PREFIX))
        return f"shielded-{name}", PREFIX + spec
    splits = [(argument[:k], argument[k + 1 :]) for k, character in enumerate(argument) if character == "="]
    if _is_file(argument) or not splits:
        custom = CLASS.fullmatch(argument)
        return custom["name"] if custom else name_of(Path(argument)) if "." in argument else argument, argument
    return next((split for split in splits if _is_known(split[1])), splits[0])


def _is_known(spec: str) -> bool:
    bare = spec.removeprefix(PREFIX)
    return bare in NAMES or policy_file(bare) != bare or bool(CLASS.fullmatch(bare)) or _is_file(spec)


def _is_file(spec: str) -> bool:
    path, _ = file_and_sheet(spec.removeprefix(PREFIX))
    return path.suffix in FILES and path.exists()


def is_schedule_file(argument: str) -> bool:
    """Whether a policy argument is a schedule file of the user."""
    return bool(user_policies([argument])) and file_and_sheet(name_and_spec(argument)[1])[0].suffix in SCHEDULES


def user_policies(specs: Sequence[str]) -> list[str]:
    """Names of the user's policies: classes, and files other than shipped agents."""
    pairs = [(name, spec.removeprefix(PREFIX)) for name, spec in map(name_and_spec, specs)]
    return [
        name
        for name, spec in pairs
        if CLASS.fullmatch(spec) or (_is_file(spec) and not (spec.endswith(".safetensors") and ships("agents", spec)))
    ]


def make_policy(spec: str, config: TaskConfig, vibration: VibrationMap | None = None, classes: bool = False) -> Policy:
    """Make a policy from a name, schedule (``SCHEDULES``), law (.json), bundle (.safetensors) or class.

    A law is that of a recommendation, or the constants of plc-integral. Shipped agents are NAME (training seed 0) or
    NAME@SEED. "shielded:" before a name or file adds the shield. In a task with withdrawal, agents that were trained in
    one act on both passes. Other policies act on the insertion; the withdrawal follows the columns of the schedule
    file, or is as fast as possible.

    Args:
        spec: name, file or "module:Class"; ``Class(config)`` must return a ``Policy``.
        config: task.
        vibration: vibration map; default: the shipped one.
        classes: accept "module:Class", which imports code; False for specs from a file.
    """
    if config.returns:
        return _round_trip(spec, config, vibration, classes)
    if spec.startswith(PREFIX):
        if spec.removeprefix(PREFIX) in PLANNERS:
            raise ValueError(f"policy = {spec!r}: the shield needs a policy that acts on observations, not a planner")
        return Shielded(config, make_policy(spec.removeprefix(PREFIX), config, vibration, classes))
    spec = policy_file(spec)
    suffix = file_and_sheet(spec)[0].suffix
    if spec in BUILT_IN:
        kind, arguments = BUILT_IN[spec]
        return kind(config, **arguments)
    if spec in (*MAP_POLICIES, *PLANNERS):
        vibration = vibration or stored_map()
        check_measure(vibration, config)
        on_map, settings = MAP_POLICIES[spec] if spec in MAP_POLICIES else (InsertionPlanner, PLANNERS[spec])
        return on_map(config, vibration=vibration, **settings)
    if spec in LAWS:
        return LAWS[spec](config)
    if spec in STORED:
        return Scheduled(config, Schedule.read(DATA / f"{spec}.csv"))
    if spec == BY_DIAMETER:
        return ByDiameter.read(config, DATA)
    if suffix in SCHEDULES:
        schedule = read_schedule(spec)
        _warn_of_limits(spec, schedule, config)
        return (Replayed if schedule.over == "time" else Scheduled)(config, schedule)
    if suffix == ".json" and '"constants"' in read_text(Path(spec), MAX_JSON):
        return PlcIntegral(config, read_constants(spec))
    if suffix == ".json":
        return LawPolicy(config, law=Law.read(spec))
    if suffix == ".safetensors":
        from probe_agents.policies.bundle import load_bundle  # torch takes seconds to import

        return load_bundle(spec, config)
    if custom := CLASS.fullmatch(spec):
        if not classes:
            raise ValueError(f"policy = {spec!r}: a class imports code, which specs from a file must not do")
        return _custom(config, **custom.groupdict())
    names = (*NAMES, *shipped_agents(), *shipped_names("schedules"))
    similar, successor = " or ".join(difflib.get_close_matches(spec, names)), REPLACED.get(spec.partition("@")[0])
    hint = f" It was removed: use {successor}." if successor else f" Did you mean {similar}?" * bool(similar)
    raise ValueError(
        f"unknown policy {spec!r}.{hint} `probe-env agents` lists all;"
        f" files end with {', '.join(FILES)}, and a class is module:Class"
    )


def _custom(config: TaskConfig, module: str, name: str) -> Policy:
    spec = f"{module}:{name}"
    try:
        kind = getattr(import_module(module), name, None)
    except Exception as error:
        hint = "install it, or put its folder on PYTHONPATH"
        raise ValueError(f"policy = {spec!r} cannot be imported ({_reason(error)}): {hint}") from error
    if not isinstance(kind, type):
        raise ValueError(f"policy = {spec!r}: {module} has no class {name}")
    missing = [method for method in ("predict", "describe") if not callable(getattr(kind, method, None))]
    if missing:
        raise ValueError(f"policy = {spec!r}: the class has no method {' and no method '.join(missing)}")
    try:
        return kind(config)  # type: ignore[no-any-return]
    except Exception as error:
        raise ValueError(f"policy = {spec!r} cannot be created for the task ({_reason(error)})") from error


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {one_line(str(error))}"


def _round_trip(spec: str, config: TaskConfig, vibration: VibrationMap | None, classes: bool) -> Policy:
    if spec in PLANNERS:
        raise ValueError(f"policy = {spec!r} plans insertions only: use passes = 'in'")
    file = Path(policy_file(spec.removeprefix(PREFIX)))
    if file.suffix == ".safetensors":
        from probe_agents.policies.bundle import load_bundle

        if load_bundle(file).config.returns:
            if spec.startswith(PREFIX):
                raise ValueError(f"policy = {spec!r}: the shield acts on the insertion only, this agent on both passes")
            return load_bundle(file, config)
    back = read_withdrawal(file) if file_and_sheet(file)[0].suffix in SCHEDULES else None
    if back is not None:
        _warn_of_limits(f"{spec}, withdrawal", back, config)
    insertion = make_policy(spec, insertion_task(config), vibration, classes)
    return RoundTripPolicy(config, insertion, back or fastest_withdrawal(config))


def domains_of(specs: Sequence[str], policies: Mapping[str, Policy]) -> dict[str, Domain | None]:
    """The domain of each of ``named_policies``; None: any tube."""
    domains: dict[str, Domain | None] = {}
    for name, spec in map(name_and_spec, specs):
        policy = policies[name]
        shipped = policy_file(spec.removeprefix(PREFIX)) in (*STORED, BY_DIAMETER)
        domains[name] = Domain.of_map(stored_map()) if shipped else getattr(policy, "domain", None)
    return domains


def _warn_of_limits(spec: str, schedule: Schedule, config: TaskConfig) -> None:
    """Warn about feed or air of a schedule beyond the task's range; over time standstills are allowed."""
    for name, values, (low, high), factor, unit in (
        ("feed speed", schedule.feed_speed, config.feed_speeds, 1.0, "m/s"),
        ("air supply", schedule.air_supply_rate, config.air_supply_rates, 3600.0, "m3/h"),
    ):
        if schedule.over == "time" and name == "feed speed" and max(values) <= high * (1.0 + 1e-6):
            continue
        if min(values) < low * (1.0 - 1e-6) or max(values) > high * (1.0 + 1e-6):
            warnings.warn(
                f"{spec}: {name} of {min(values) * factor:g} to {max(values) * factor:g} {unit} is outside the"
                f" task's range {low * factor:g} to {high * factor:g} {unit}: it is clipped",
                stacklevel=2,  # the same line for all callers, so that Python shows the warning once
            )
