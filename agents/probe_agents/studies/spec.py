"""A study as a TOML file: question, policies, tubes, varied fields and compared metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain, product
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from probe_agents.evaluation.folder import EPISODES
from probe_agents.evaluation.kpis import OVER_TUBES
from probe_env.envs.contexts import SPLIT_SIZES, Split
from probe_env.settings import Model, one_line_errors

ROOTS: Final = ("task", "scene", "sensor", "fidelity", "plant")
"""First part of a dotted field; ``scene`` and ``sensor`` are those of the task."""
WHOLE: Final = ("fidelity", "probe")
"""Fields without a dot: name of a fidelity or a probe design."""
Changes = dict[str, Any]
"""Dotted field -> value."""


def _listed(value: Any) -> Any:
    """A single entry as a tuple."""
    return (value,) if isinstance(value, str | Mapping) else value


class Compare(Model):
    """The comparison.

    Attributes:
        metrics: columns of episodes (means over tubes), or ``a90_95_percent_wall`` (over all tubes together).
        baseline: columns and values; a row is compared with the row that has these and is equal otherwise. With several
            baselines there is one comparison each. Default: the first varied setting, if any, else the first policy.
        upper: columns and values of an upper bound: adds the share of the reward between baseline and upper bound.
    """

    metrics: tuple[str, ...] = ("reward", "inspection_time_s", "share_within_limit")
    baseline: Annotated[tuple[Changes, ...], BeforeValidator(_listed)] = ()
    upper: Changes | None = None

    @field_validator("metrics")
    @classmethod
    def _metrics_are_columns(cls, metrics: tuple[str, ...]) -> tuple[str, ...]:
        known = {*EPISODES, *OVER_TUBES} - {"policy", "context", "seed"}
        unknown = [name for name in metrics if not {name, name.removeprefix("in_"), name.removeprefix("back_")} & known]
        if unknown or not metrics:
            accepted = ", ".join(sorted(name for name in known if not name.startswith("pod_")))
            text = f"unknown metrics: {', '.join(unknown) or 'none'}; accepted: {accepted}"
            raise ValueError(text)
        return metrics


class Study(Model):
    """A study: every policy in every setting on the same tubes.

    Attributes:
        question: question of the study.
        policies: names, or tables of a ``name`` and parameters of that policy; all combinations of lists are run.
        contexts: list of tubes.
        limit: number of tubes, the first of the list; 0: all.
        tube: a plant's file or name; default: table 2's tubes.
        seeds: seeds of sensor noise and start.
        fidelity: names of fidelities.
        policies_know: whether policies are made for the varied or the unvaried task.
        set: changed fields of all settings.
        vary: fields and their values, of which all combinations are settings; or a list of settings.
        compare: the comparison.
        figure: two metrics of a scatter plot; default: the differences of the first metric.
    """

    question: Annotated[str, Field(min_length=1)]
    policies: Annotated[tuple[str | Changes, ...], Field(min_length=1)]
    contexts: Split = "test"
    limit: Annotated[int, Field(ge=0)] = 6
    tube: str | None = None
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = (0,)
    fidelity: Annotated[tuple[str, ...], BeforeValidator(_listed), Field(min_length=1)] = ("fast",)
    policies_know: Literal["varied task", "unvaried task"] = "varied task"
    set: Changes = Field(default_factory=dict)
    vary: dict[str, tuple[Any, ...]] | tuple[Changes, ...] = Field(default_factory=dict)
    compare: Compare = Compare()
    figure: tuple[str, str] | None = None

    @field_validator("policies")
    @classmethod
    def _families_have_names(cls, policies: tuple[str | Changes, ...]) -> tuple[str | Changes, ...]:
        for entry in policies:
            if not isinstance(entry, str) and not isinstance(entry.get("name"), str):
                raise ValueError("a table of a policy needs a name")
        return policies

    @field_validator("set", "vary")
    @classmethod
    def _fields_are_known(cls, fields: Any) -> Any:
        for name in chain.from_iterable((fields,) if isinstance(fields, Mapping) else fields):
            root, _, rest = name.partition(".")
            if name not in WHOLE and not (root in ROOTS and rest):
                accepted = ", ".join((*WHOLE, *(f"{root}.FIELD" for root in ROOTS)))
                raise ValueError(f"{name!r} is not one of {accepted}")
        return fields

    @model_validator(mode="after")
    def _is_in_range(self) -> Study:
        if self.limit > SPLIT_SIZES[self.contexts]:
            raise ValueError(
                f"limit = {self.limit} is outside the accepted range 0 (all) to {SPLIT_SIZES[self.contexts]}"
            )
        if self.figure and not set(self.figure) <= set(self.compare.metrics):
            raise ValueError(f"figure must be two of compare.metrics (given: {self.figure})")
        if isinstance(self.vary, Mapping) and not all(self.vary.values()):
            raise ValueError("every field of vary needs at least one value")
        return self

    @property
    def varied(self) -> tuple[str, ...]:
        """Dotted fields that differ between settings; they are columns of all tables."""
        tables = (self.vary,) if isinstance(self.vary, Mapping) else self.vary
        return tuple(dict.fromkeys(name for table in tables for name in table if name != "fidelity"))

    def changed(
        self, limit: int | None, policies: tuple[str, ...], fidelity: tuple[str, ...], tube: Path | None
    ) -> Study:
        """The study with other values; reference policies of the comparison remain."""
        update: Changes = {} if limit is None else {"limit": limit}
        if policies:
            needed = [entry.get("policy") for entry in (*self.compare.baseline, self.compare.upper or {})]
            references = [entry for entry in self.policies if _name(entry) in needed and _name(entry) not in policies]
            update["policies"] = (*references, *policies)
        update |= {"fidelity": fidelity} if fidelity else {}
        update |= {"tube": str(tube)} if tube else {}
        with one_line_errors():
            return self.model_copy(update=update)

    def settings(self) -> Iterator[tuple[str, Changes]]:
        """Fidelity and changes of every setting, the first of ``vary`` first."""
        if isinstance(self.vary, Mapping):
            changes = [dict(zip(self.vary, values, strict=True)) for values in product(*self.vary.values())]
        else:
            changes = list(self.vary)
        for fidelity in self.fidelity:
            for change in changes:
                rest = {name: value for name, value in change.items() if name != "fidelity"}
                yield change.get("fidelity", fidelity), rest

    def members(self) -> Iterator[tuple[str, Changes]]:
        """Name and parameters of every policy, with all combinations of lists."""
        for entry in self.policies:
            if isinstance(entry, str):
                yield entry, {}
                continue
            lists = {k: v if isinstance(v, tuple) else (v,) for k, v in entry.items() if k != "name"}
            for values in product(*lists.values()):
                yield entry["name"], dict(zip(lists, values, strict=True))


def _name(entry: str | Changes) -> str:
    return entry if isinstance(entry, str) else str(entry["name"])
