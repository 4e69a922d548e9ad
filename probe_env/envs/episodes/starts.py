"""How an episode begins: tube and probe, given or drawn, and how much of the probe is in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypedDict, get_args

import numpy as np
from pydantic import ValidationError

from probe_env.design import RANGES, Design
from probe_env.envs.contexts import SPLIT_SIZES, Context, Ranges, Split, draw_context, load_contexts
from probe_env.envs.plants import GivenPlant, map_beside, plant_of
from probe_env.envs.task import TaskConfig, ungrouped
from probe_env.envs.task.config import scene_of
from probe_env.envs.vibration_map import VibrationMap
from probe_env.fidelity import Fidelity
from probe_env.scene import Scene, whole_pitches
from probe_env.settings import explain, tuples

NamedContexts = Literal["random"] | Split
Contexts = NamedContexts | Sequence[Context | Mapping[str, float]] | Mapping[str, Any]
"""A name, a list of one's own, or the ranges of random ones (see ``contexts.Ranges``)."""
Probes = Literal["scene", "random"]
SHORTEST_START: Final = 5.0  # [m] inserted
SETTLING: Final = (0.2, 63.0 / 3600.0)
"""Feed speed [m/s] and air supply [m3/s] before an episode, unless others are given."""
WAY_BACK: Final[dict[str, Any]] = {"couple": "tangent", "contact": {"cable": True}}
"""What the scene of a probe that is drawn back must have: it is pressed."""
CARRIER_AT_START: Final = 2.5  # [m], at least
RANDOM_TUBES: Final = 1024
"""Of a plant, from which a random context is drawn."""


class PlaceSettings(TypedDict, total=False):
    """Where something is tried and how closely it is simulated; see ``InsertionEnv`` for what each means."""

    tube: GivenPlant
    scene: Scene | Mapping[str, Any] | None
    fidelity: str | Fidelity | Mapping[str, Any]
    contexts: Contexts


class EpisodeSettings(PlaceSettings, total=False):
    """What episodes share besides the task; see ``InsertionEnv`` for what each means. SI units."""

    feed_speed: float
    air_supply_rate: float
    probes: Probes
    surrogate_map: VibrationMap | str | Path | None


DEFAULTS: Final[EpisodeSettings] = {
    "tube": None, "scene": None, "fidelity": "standard", "contexts": "random",
    "feed_speed": SETTLING[0], "air_supply_rate": SETTLING[1], "probes": "scene",
    "surrogate_map": None,
}  # fmt: skip


def settling(config: TaskConfig, settings: EpisodeSettings) -> tuple[float, float]:
    """Feed speed [m/s] and air supply [m3/s] before an episode: as given, else the usual, or the nearest in range."""
    ranges = config.feed_speeds, config.air_supply_rates
    feed, air = (float(np.clip(usual, *range_)) for usual, range_ in zip(SETTLING, ranges, strict=True))
    return settings.get("feed_speed", feed), settings.get("air_supply_rate", air)


@contextmanager
def restored_on_error(rngs: Iterable[np.random.Generator]) -> Iterator[None]:
    """Generators go back to where they were if an error leaves the block."""
    before = [(rng, rng.bit_generator.state) for rng in rngs]
    try:
        yield
    except BaseException:
        for rng, state in before:
            rng.bit_generator.state = state
        raise


@dataclass(frozen=True)
class EpisodeSampler:
    """Draws tube and probe of an episode, see ``EpisodeSettings``; ValueError for contexts or probes not known."""

    config: TaskConfig
    contexts: Contexts
    probes: Probes
    feed_speed: float
    air_supply_rate: float

    def __post_init__(self) -> None:
        if self.probes not in get_args(Probes):
            raise ValueError(f"probes = {self.probes!r} is not one of {', '.join(get_args(Probes))}")
        object.__setattr__(self, "contexts", checked_contexts(self.contexts))

    @property
    def scene(self) -> Scene:
        """What contexts and options change."""
        return self.config.scene

    @property
    def stiffest(self) -> Scene:
        """The scene with the hardest contact and the lightest floats that may be drawn: a step for it holds for all."""
        source = checked_contexts(self.contexts)
        drawn = source.stiffest if isinstance(source, Ranges) else max(c.contact_stiffness for c in source)
        update: dict[str, Any] = {"contact": {"stiffness": max(drawn, self.scene.contact.stiffness)}}
        if self.probes == "random":
            lightest = {name: RANGES[name][0] for name in ("line_density", "float_pitch")}
            probe = Design.model_validate(lightest).cut_to(self.scene).probe(self.scene.probe)
            update |= {"probe": probe, "carrier_length": whole_pitches(self.scene.carrier_length, probe)}
        return self.scene.model_copy(update=update | (WAY_BACK if self.config.returns else {}))

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any]) -> tuple[Context, Scene]:
        """Context and scene of an episode, see ``Episodes.reset`` for the options; whatever they fix is drawn as well.

        Raises:
            ValueError: an option is not known or not valid.
        """
        fixed = dict(options)
        changes: dict[str, Any] = {name: fixed.pop(name) for name in ("probe", "carrier_length") if name in fixed}
        context = drawn_context(self.contexts, rng, fixed)
        drawn = Design.random(rng).cut_to(self.scene).built.model_dump() if self.probes == "random" else {}
        changes["probe"] = drawn | dict(changes.get("probe", {}))
        return context, self.build(context, changes)

    def build(self, context: Context, changes: Mapping[str, Any]) -> Scene:
        """The scene at the start of an episode: context, changed probe, start length, feed and air of the settling."""
        scene = context.apply(self.scene.model_copy(update=WAY_BACK) if self.config.returns else self.scene)
        if self.config.growing and "carrier_length" in changes:
            raise ValueError("carrier_length is not an option here: the probe starts short and is fed in")
        probe = scene.probe.model_copy(update=changes.get("probe", {}))
        carrier = changes.get("carrier_length", scene.carrier_length)
        if self.probes == "random":  # of any pitch
            carrier = whole_pitches(carrier, probe)
        if self.config.growing:
            start = max(SHORTEST_START, probe.guide_length + CARRIER_AT_START)
            carrier = round((start - probe.guide_length) / probe.float_pitch) * probe.float_pitch
        settled = {"feed_speed": self.feed_speed, "air_supply_rate": self.air_supply_rate}
        return scene.model_copy(update={"probe": probe, "carrier_length": carrier} | settled)


def placed(
    defaults: Mapping[str, Any], config: TaskConfig | Mapping[str, Any] | None, settings: EpisodeSettings
) -> tuple[TaskConfig, EpisodeSettings]:
    """The task with the scene that it is done in, and what is left of the settings: contexts, fidelity and the rest.

    Args:
        defaults: an environment's own fields of the task.
        config: fields of the task that differ, or a whole one.
        settings: as given, with a ``tube`` or a ``scene``.

    Raises:
        ValueError: a field that is not known or not valid, or settings that exclude each other.
        TypeError: a field of the task among the settings.
    """
    for name in settings:
        if name in TaskConfig.model_fields and name != "scene":
            raise TypeError(f"{name} is a field of the task: give config={{{name!r}: ...}}")
    contexts = settings.get("contexts")
    if settings.get("tube") is not None and isinstance(contexts, str) and contexts in SPLIT_SIZES:
        raise ValueError(
            f"contexts = {contexts!r} are table 2's tubes: beside a tube leave it out, and they are drawn from what is"
            " known of it, or give Contexts of your own"
        )
    left = settings.copy()
    file = left.get("tube")
    if isinstance(file, str | Path) and map_beside(Path(file)).exists():
        left.setdefault("surrogate_map", map_beside(Path(file)))
    plant, scene = plant_of(left.pop("tube", None)), left.pop("scene", None)
    if plant is None:
        task = config
        if not isinstance(task, TaskConfig):  # of JSON, which has no tuples
            task = TaskConfig.model_validate(tuples(dict(defaults) | ungrouped(dict(config or {}))))
        return (task if scene is None else task.model_copy(update={"scene": scene_of(scene)})), left
    if scene is not None:
        raise ValueError("tube and scene: give one of them, a tube has a scene of its own")
    if isinstance(config, TaskConfig):
        raise ValueError(
            "config beside a tube must be a mapping of the fields that differ: a tube has a task of its own"
        )
    if left.get("contexts", "random") == "random":
        left["contexts"] = plant.contexts(RANDOM_TUBES)
    return plant.configured(defaults, config), left


def checked_contexts(contexts: Contexts) -> tuple[Context, ...] | Ranges:
    """What contexts are drawn from: a list, or ranges.

    Raises:
        ValueError: no such list, or one of one's own with a field that is not known or not valid; names it.
    """
    if isinstance(contexts, Ranges) or (isinstance(contexts, tuple) and all(isinstance(c, Context) for c in contexts)):
        return contexts
    if isinstance(contexts, str):
        if contexts == "random":
            return Ranges()
        if contexts not in get_args(Split):
            raise ValueError(f"contexts = {contexts!r} is not one of random, {', '.join(get_args(Split))}")
        return load_contexts(contexts)
    try:
        if isinstance(contexts, Mapping):
            return Ranges.model_validate(tuples(dict(contexts)))
        name, listed = "contexts", []
        for k, fields in enumerate(contexts):
            name = f"contexts[{k}]"
            listed.append(fields if isinstance(fields, Context) else Context.model_validate(dict(fields)))
    except ValidationError as error:
        raise ValueError(explain(error, "contexts" if isinstance(contexts, Mapping) else name)) from error
    except TypeError as error:
        raise ValueError(f"contexts = {contexts!r} is no name, list of contexts or mapping of ranges") from error
    if not listed:
        raise ValueError("contexts = [] is empty: give at least one")
    return tuple(listed)


def drawn_context(contexts: Contexts, rng: np.random.Generator, fixed: dict[str, Any]) -> Context:
    """A context from the generator, at random or from a list; ``fixed`` fixes fields or a whole "context".

    Takes "context" out of ``fixed``.

    Raises:
        ValueError: no such list, or a field that is not known or not valid.
    """
    source = checked_contexts(contexts)
    whole = fixed.pop("context", None)
    if whole is not None:
        values = whole.model_dump() if isinstance(whole, Context) else dict(whole)
        fixed = values | fixed
    if isinstance(source, Ranges):
        return draw_context(rng, fixed, source)
    return source[int(rng.integers(len(source)))].model_copy(update=fixed)
