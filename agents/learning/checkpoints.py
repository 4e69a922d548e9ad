"""Checkpoints of training: tensors and plain data, compared with the run that they are to go on with before it is."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import torch
from pydantic import Field, FiniteFloat, NonNegativeInt, ValidationError
from stable_baselines3.common.base_class import BaseAlgorithm

from agents.learning.config import Training
from agents.records.models import Stored
from agents.records.provenance import write_atomically
from agents.records.reading import read_json
from probe_env.files import MEBI, FileError, read_bytes
from probe_env.settings import explain

RUN: Final = "run.json"
"""How a run began, beside its checkpoint."""
BUFFER: Final = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""Arrays of a replay buffer."""
COUNTS: Final = ("num_timesteps", "_n_updates")
FREE: Final = ("lr", "initial_lr", "params")
"""What training itself changes of an optimiser's settings, and what is compared by itself."""
SLACK: Final = 16 * MEBI
_HINT: Final = "restore the file, or choose another folder and train again"
Named = Mapping[str, Any]


class Run(Stored):
    """``run.json``: how a run began and went on."""

    seed: int
    config: Training
    resumed: list[dict[str, Any]] = Field(default_factory=list)


class Phase(Stored):
    """A row of the learning curve."""

    seed: int
    phase: NonNegativeInt
    steps: NonNegativeInt
    reward: FiniteFloat
    inspection_time_s: FiniteFloat
    share_within_limit: FiniteFloat
    diverged: FiniteFloat
    validation_s: FiniteFloat
    wall_s: FiniteFloat
    kernel_s: FiniteFloat


def settings_that_differ(before: Training, now: Training) -> list[str]:
    """Names of settings that may not change in a run: more phases may come, other seeds beside this one, a search."""
    noted, given = (training.model_dump(mode="json") for training in (before, now))
    return [name for name in given if noted[name] != given[name] and name not in ("seeds", "phases", "search")]


def variables(model: BaseAlgorithm) -> list[str]:
    """Names of trained tensors that ``get_parameters`` leaves out: SAC's entropy coefficient."""
    return list(model._get_torch_save_params()[1])


def read_checkpoint(path: Path, model: BaseAlgorithm, config: Training | None) -> dict[str, Any]:
    """The state in a checkpoint, whole and of this very model: names, shapes, types, settings and seed.

    Args:
        path: of the checkpoint.
        model: a new one of the same settings.
        config: of the run, where it is noted.

    Raises:
        FileNotFoundError: no such file.
        FileError: damaged or of another run; the model is as it was.
    """
    state = _loaded(path, _most_bytes(model))
    try:
        _check_state(state, model)
        rows = [Phase.model_validate(row) for row in state["rows"]]
        other = settings_that_differ(Training.model_validate_json(state.get("config", "")), config) if (
            config is not None and "config" in state
        ) else []  # fmt: skip
    except ValidationError as error:
        raise FileError(path, f"not a checkpoint of a run: {explain(error)} - {_HINT}") from error
    except (_WrongError, KeyError, TypeError, AttributeError, ValueError) as error:
        reason = str(error) if isinstance(error, _WrongError) else f"{type(error).__name__} {error}"
        raise FileError(path, f"not a checkpoint of this run: {reason} - {_HINT}") from error
    if other:
        raise FileError(path, f"of a run with other settings ({', '.join(other)}) - {_HINT}")
    begun = [row.phase for row in rows]
    if any(row.seed != model.seed for row in rows) or begun != list(range(begun[0], begun[0] + len(rows))):
        raise FileError(path, f"of a run with another seed than {model.seed}, or without some of its phases - {_HINT}")
    if rows[-1].steps != state["counts"]["num_timesteps"]:
        raise FileError(path, f"counts.num_timesteps: differs from the {rows[-1].steps} of its last phase - {_HINT}")
    return state


class _WrongError(Exception):
    """What is not as it should be."""


def _loaded(path: Path, most: int) -> dict[str, Any]:
    content = read_bytes(path, most)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            total = sum(member.file_size for member in archive.infolist())
        if total > most:
            raise FileError(path, f"{total} bytes when unpacked are more than the {most} of this run - {_HINT}")
        state = torch.load(io.BytesIO(content), weights_only=True, map_location="cpu")
    except FileError:
        raise
    except Exception as error:  # of the unpickler: whatever the damage leads to
        raise FileError(path, f"cut off or not a checkpoint; nothing in it was run - {_HINT}") from error
    if not isinstance(state, dict):
        raise FileError(path, f"not a checkpoint: {type(state).__name__} - {_HINT}")
    return state


def _most_bytes(model: BaseAlgorithm) -> int:
    """Weights, twice as much for the optimisers, and the replay buffer."""
    weights: int = sum(value.numel() * value.element_size() for value in model.policy.state_dict().values())
    replay = getattr(model, "replay_buffer", None)
    stored: int = sum(getattr(replay, name).nbytes for name in BUFFER) if replay is not None else 0
    return 3 * weights + stored + SLACK


def _check_state(state: Named, model: BaseAlgorithm) -> None:
    fresh = model.get_parameters()
    _check_names("parameters", state["parameters"], fresh)
    for name, part in fresh.items():
        given = state["parameters"][name]
        if "param_groups" in part:
            _check_optimiser(name, given, attrgetter(name)(model))
        else:
            _check_tensors(name, given, part)
    _check_tensors("variables", state["variables"], {name: getattr(model, name) for name in variables(model)})
    _check_names("counts", state["counts"], dict.fromkeys(COUNTS))
    for name in COUNTS:
        _check_count(f"counts.{name}", state["counts"][name])
    if not isinstance(state["rows"], list) or not state["rows"]:
        raise _WrongError("rows: no phases")
    replay = getattr(model, "replay_buffer", None)
    if replay is not None:
        _check_tensors("replay", state["replay"], {n: torch.as_tensor(getattr(replay, n)) for n in BUFFER})
        _check_count("replay_place.pos", state["replay_place"]["pos"], replay.buffer_size - 1)
        if not isinstance(state["replay_place"]["full"], bool):
            raise _WrongError("replay_place.full: neither true nor false")


def _check_names(place: str, given: Any, needed: Named) -> None:
    if not isinstance(given, Mapping):
        raise _WrongError(f"{place}: {type(given).__name__}")
    for name in [*needed, *given]:
        if name not in given or name not in needed:
            raise _WrongError(f"{place}.{name}: {'missing' if name in needed else 'not part of this network'}")


def _check_tensors(place: str, given: Any, needed: Mapping[str, torch.Tensor]) -> None:
    _check_names(place, given, needed)
    for name, like in needed.items():
        _check_tensor(f"{place}.{name}", given[name], like.shape, like.dtype)


def _check_tensor(place: str, value: Any, shape: torch.Size, dtype: torch.dtype) -> None:
    if not isinstance(value, torch.Tensor):
        raise _WrongError(f"{place}: {type(value).__name__}, not a tensor")
    if value.shape != shape or value.dtype != dtype:
        kinds = (f"{kind} {tuple(size)}" for kind, size in ((value.dtype, value.shape), (dtype, shape)))
        raise _WrongError(f"{place}: {' where this run has '.join(kinds)}")
    if value.is_floating_point() and not torch.isfinite(value).all():
        raise _WrongError(f"{place}: holds values that are not finite")


def _check_optimiser(place: str, given: Any, optimiser: torch.optim.Optimizer) -> None:
    _check_names(place, given, {"state": None, "param_groups": None})
    fresh = optimiser.state_dict()["param_groups"]
    if not isinstance(given["param_groups"], list) or len(given["param_groups"]) != len(fresh):
        raise _WrongError(f"{place}.param_groups: not those of this run")
    for group, like in zip(given["param_groups"], fresh, strict=True):
        if group["params"] != like["params"] or any(group[n] != like[n] for n in like if n in group and n not in FREE):
            raise _WrongError(f"{place}.param_groups: of other settings")
        if not all(math.isfinite(number) for number in _numbers(group)):
            raise _WrongError(f"{place}.param_groups: holds numbers that are not finite")
    shapes = [parameter.shape for group in optimiser.param_groups for parameter in group["params"]]
    for number, entries in given["state"].items():
        for name, value in entries.items():
            if not isinstance(value, torch.Tensor) or not isinstance(number, int) or not 0 <= number < len(shapes):
                raise _WrongError(f"{place}.state.{number}.{name}: not part of this network")
            _check_tensor(f"{place}.state.{number}.{name}", value, value.shape and shapes[number], torch.float32)


def _numbers(group: Named) -> Iterator[float]:
    for name, value in group.items():
        if name != "params":
            yield from (part for part in (value if isinstance(value, tuple) else (value,)) if isinstance(part, float))


def _check_count(place: str, value: Any, most: int = 2**62) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
        raise _WrongError(f"{place} = {str(value)[:40]} is not a whole number from 0 to {most}")


def save_checkpoint(model: BaseAlgorithm, rows: list[dict[str, Any]], path: Path) -> None:
    """Weights, optimisers, counts and learning curve, atomically; of off-policy algorithms also the replay buffer."""
    state: dict[str, Any] = {"parameters": model.get_parameters(), "rows": rows}
    state["counts"] = {"num_timesteps": model.num_timesteps, "_n_updates": int(getattr(model, "_n_updates", 0))}
    state["variables"] = {name: getattr(model, name).detach() for name in variables(model)}
    config = noted(path.with_name(RUN))
    if config is not None:
        state["config"] = config.model_dump_json()
    replay = getattr(model, "replay_buffer", None)
    if replay is not None:
        state["replay"] = {name: torch.as_tensor(getattr(replay, name)) for name in BUFFER}
        state["replay_place"] = {"pos": int(replay.pos), "full": bool(replay.full)}
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_atomically(path, buffer.getvalue())


def noted(path: Path) -> Training | None:
    """Settings of a run as they are noted."""
    return read_json(path, Run).config if path.exists() else None


def restore(model: BaseAlgorithm, path: Path) -> list[dict[str, Any]]:
    """Set the model as it was at the checkpoint; the learning curve until then. Tensors and plain data only."""
    if not path.exists():
        return []
    state = read_checkpoint(path, model, noted(path.with_name(RUN)))
    model.set_parameters(state["parameters"])
    for name, value in state["counts"].items():
        setattr(model, name, value)
    for name, value in state["variables"].items():
        getattr(model, name).data.copy_(value)
    replay = getattr(model, "replay_buffer", None)
    if replay is not None:
        for name, values in state["replay"].items():
            getattr(replay, name)[:] = values.numpy()
        replay.pos, replay.full = state["replay_place"]["pos"], state["replay_place"]["full"]
    rows: list[dict[str, Any]] = state["rows"]
    return rows
