"""A study as a TOML file: a question, policies, tubes, fields that are varied and metrics that are compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain, product
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from agents.evaluation.folder import EPISODES, EPISODES_NEWER
from agents.evaluation.kpis import OVER_TUBES
from probe_env.envs.contexts import SPLIT_SIZES, Split
from probe_env.settings import Model, one_line_errors

ROOTS: Final = ("task", "scene", "sensor", "fidelity", "plant")
"""First part of a dotted field; ``scene`` and ``sensor`` are those of the task."""
WHOLE: Final = ("fidelity", "probe")
"""Fields without a dot: a fidelity or a probe design by its name."""
Changes = dict[str, Any]
"""Dotted field -> value."""


def _listed(value: Any) -> Any:
    """One entry as a tuple of one."""
    return (value,) if isinstance(value, str | Mapping) else value


class Compare(Model):
    """What is compared.

    Attributes:
        metrics: columns of episodes (means over tubes), or ``a90_95_percent_wall`` (of all tubes together).
        baseline: columns and values; a row is compared with the one that has these and is equal otherwise. Several are
            compared one after the other. Default: the first setting that is varied, if any, else the first policy.
        upper: columns and values of an upper bound: adds the share of the reward between baseline and upper bound.
    """

    metrics: tuple[str, ...] = ("reward", "inspection_time_s", "share_within_limit")
    baseline: Annotated[tuple[Changes, ...], BeforeValidator(_listed)] = ()
    upper: Changes | None = None

    @field_validator("metrics")
    @classmethod
    def _metrics_are_columns(cls, metrics: tuple[str, ...]) -> tuple[str, ...]:
        known = {*EPISODES, *EPISODES_NEWER, *OVER_TUBES} - {"policy", "context", "seed"}
        unknown = [name for name in metrics if not {name, name.removeprefix("in_"), name.removeprefix("back_")} & known]
        if unknown or not metrics:
            accepted = ", ".join(sorted(name for name in known if not name.startswith("pod_")))
            text = f"metrics that are not known: {', '.join(unknown) or 'none given'}; accepted: {accepted}"
            raise PydanticCustomError("metrics", "{text}", {"text": text})
        return metrics


class Study(Model):
    """A study: every policy in every setting on the same tubes.

    Attributes:
        question: that it answers.
        policies: names, or tables of a ``name`` and parameters of that policy, of which lists are swept.
        contexts: list of tubes.
        limit: the first so many of them; 0: all.
        tube: a plant's file or name; default: table 2's tubes.
        seeds: of sensor noise and start.
        fidelity: names of fidelities.
        policies_know: whether policies are made for the varied task, or for the one before it was varied.
        set: fields that are changed in all settings.
        vary: fields and their values, of which all combinations are settings; or the settings themselves.
        compare: what is compared.
        figure: two metrics to draw against each other; default: the differences of the first metric.
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
                raise PydanticCustomError("policies", "a table of a policy needs its name")
        return policies

    @field_validator("set", "vary")
    @classmethod
    def _fields_are_known(cls, fields: Any) -> Any:
        for name in chain.from_iterable((fields,) if isinstance(fields, Mapping) else fields):
            root, _, rest = name.partition(".")
            if name not in WHOLE and not (root in ROOTS and rest):
                accepted = ", ".join((*WHOLE, *(f"{root}.FIELD" for root in ROOTS)))
                raise PydanticCustomError("field", "{text}", {"text": f"{name!r} is not one of {accepted}"})
        return fields

    @model_validator(mode="after")
    def _is_in_range(self) -> Study:
        if self.limit > SPLIT_SIZES[self.contexts]:
            raise PydanticCustomError(
                "limit", f"limit = {self.limit} is outside the accepted range 0 (all) to {SPLIT_SIZES[self.contexts]}"
            )
        if self.figure and not set(self.figure) <= set(self.compare.metrics):
            raise PydanticCustomError("figure", f"figure must be two of compare.metrics (given: {self.figure})")
        if isinstance(self.vary, Mapping) and not all(self.vary.values()):
            raise PydanticCustomError("vary", "every field of vary needs a value at least")
        return self

    @property
    def varied(self) -> tuple[str, ...]:
        """Dotted fields that differ between settings; they are columns of all tables."""
        tables = (self.vary,) if isinstance(self.vary, Mapping) else self.vary
        return tuple(dict.fromkeys(name for table in tables for name in table if name != "fidelity"))

    def changed(
        self, limit: int | None, policies: tuple[str, ...], fidelity: tuple[str, ...], tube: Path | None
    ) -> Study:
        """The same study with what is given instead of its own; policies that it compares with are kept.

        Raises:
            ValueError: a value is not valid.
        """
        update: Changes = {} if limit is None else {"limit": limit}
        if policies:
            needed = [entry.get("policy") for entry in (*self.compare.baseline, self.compare.upper or {})]
            kept = [entry for entry in self.policies if _name(entry) in needed and _name(entry) not in policies]
            update["policies"] = (*kept, *policies)
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
        """Name of every policy and its parameters, those that are swept one after the other."""
        for entry in self.policies:
            if isinstance(entry, str):
                yield entry, {}
                continue
            swept = {k: v if isinstance(v, tuple) else (v,) for k, v in entry.items() if k != "name"}
            for values in product(*swept.values()):
                yield entry["name"], dict(zip(swept, values, strict=True))


def _name(entry: str | Changes) -> str:
    return entry if isinstance(entry, str) else str(entry["name"])
