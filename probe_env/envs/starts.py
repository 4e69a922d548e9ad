"""How an episode begins: tube and probe, given or drawn, and how much of the probe is in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypedDict, get_args

import numpy as np
from pydantic import ValidationError

from probe_env.design import RANGES, Design
from probe_env.envs.contexts import Context, Ranges, Split, draw_context, load_contexts
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import Fidelity
from probe_env.scene import Probe, Scene
from probe_env.settings import explain, tuples

NamedContexts = Literal["random"] | Split
Contexts = NamedContexts | Sequence[Context | Mapping[str, float]] | Mapping[str, Any]
"""A name, a list of one's own, or the ranges of random ones (see ``contexts.Ranges``)."""
Probes = Literal["scene", "random"]
SHORTEST_START: Final = 5.0  # [m] inserted
SETTLING: Final = (0.2, 63.0 / 3600.0)
"""Feed speed [m/s] and air supply [m3/s] before an episode, unless others are given."""
CARRIER_AT_START: Final = 2.5  # [m], at least


class EpisodeSettings(TypedDict, total=False):
    """What episodes share besides the task: keyword arguments of everything that plays them.

    Attributes:
        scene: what contexts and options change, a mapping of what differs from table 2's, or None for that (default).
        fidelity: preset name (default "standard"), settings or a mapping of them, see ``fidelity.PRESETS``.
        contexts: "random" (default), the shipped list ("train", "validation", "test") that every reset draws from, a
            list of one's own, or ranges.
        feed_speed: of the settling before an episode [m/s], default 0.2.
        air_supply_rate: of the settling [m3/s], default 63 m3/h.
        probes: "scene" (default), or "random": every reset draws a ``Design``.
    """

    scene: Scene | Mapping[str, Any] | None
    fidelity: str | Fidelity | Mapping[str, Any]
    contexts: Contexts
    feed_speed: float
    air_supply_rate: float
    probes: Probes


DEFAULTS: Final[EpisodeSettings] = {
    "scene": None, "fidelity": "standard", "contexts": "random",
    "feed_speed": SETTLING[0], "air_supply_rate": SETTLING[1], "probes": "scene",
}  # fmt: skip


VERSIONS: Final[dict[str, EpisodeSettings]] = {"v0": {"fidelity": "standard-v0"}, "v1": {}}
"""Versions of the environments, with what each sets otherwise than ``DEFAULTS``: the physics that results are of."""


def scene_of(scene: Scene | Mapping[str, Any] | None) -> Scene:
    """What is simulated: table 2's scene, changed by a mapping, or a whole one.

    A mapping of plain values goes through JSON, and so does an environment's ``spec``.

    Raises:
        ValueError: a field that is not known or not valid.
    """
    if scene is None or isinstance(scene, Scene):
        return scene or Scene()
    return Scene.model_validate(dict(scene))


@dataclass(frozen=True)
class Starts:
    """What episodes begin from.

    Attributes:
        config: the task.
        scene: what contexts and options change.
        contexts: "random", the shipped list that is drawn from, a list of one's own, or ranges.
        probes: "scene", or "random": a ``Design`` is drawn.
        feed_speed, air_supply_rate: of the settling before an episode [m/s], [m3/s].

    Raises:
        ValueError: no such list of contexts or of probes.
    """

    config: TaskConfig
    scene: Scene
    contexts: Contexts
    probes: Probes
    feed_speed: float
    air_supply_rate: float

    def __post_init__(self) -> None:
        if self.probes not in get_args(Probes):
            raise ValueError(f"probes = {self.probes!r} is not one of {', '.join(get_args(Probes))}")
        object.__setattr__(self, "contexts", checked_contexts(self.contexts))

    @property
    def stiffest(self) -> Scene:
        """The scene with the hardest contact and the lightest floats that may be drawn: a step for it holds for all."""
        source = checked_contexts(self.contexts)
        drawn = source.stiffest if isinstance(source, Ranges) else max(c.contact_stiffness for c in source)
        update: dict[str, Any] = {"contact": {"stiffness": max(drawn, self.scene.contact.stiffness)}}
        if self.probes == "random":
            lightest = {name: RANGES[name][0] for name in ("line_density", "float_pitch")}
            probe = Design.model_validate(lightest).probe(self.scene.probe)
            update |= {"probe": probe, "carrier_length": _whole_pitches(self.scene.carrier_length, probe)}
        return self.scene.model_copy(update=update)

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any]) -> tuple[Context, Scene]:
        """Context and scene of an episode, see ``Episodes.reset`` for the options; whatever they fix is drawn as well.

        Raises:
            ValueError: an option is not known or not valid.
        """
        given = dict(options)
        changes: dict[str, Any] = {name: given.pop(name) for name in ("probe", "carrier_length") if name in given}
        context = drawn_context(self.contexts, rng, given)
        drawn = Design.random(rng).built.model_dump() if self.probes == "random" else {}
        changes["probe"] = drawn | dict(changes.get("probe", {}))
        return context, self.build(context, changes)

    def build(self, context: Context, changes: Mapping[str, Any]) -> Scene:
        """The scene at the start of an episode: context, changed probe, start length, feed and air of the settling."""
        scene = context.apply(self.scene)
        if self.config.growing and "carrier_length" in changes:
            raise ValueError("carrier_length is not an option here: the probe starts short and is fed in")
        probe = scene.probe.model_copy(update=changes.get("probe", {}))
        carrier = changes.get("carrier_length", scene.carrier_length)
        if self.probes == "random":  # of any pitch
            carrier = _whole_pitches(carrier, probe)
        if self.config.growing:
            start = max(SHORTEST_START, probe.guide_length + CARRIER_AT_START)
            carrier = round((start - probe.guide_length) / probe.float_pitch) * probe.float_pitch
        update: dict[str, Any] = {
            "probe": probe,
            "carrier_length": carrier,
            "feed_speed": self.feed_speed,
            "air_supply_rate": self.air_supply_rate,
        }
        return scene.model_copy(update=update)


def _whole_pitches(length: float, probe: Probe) -> float:
    """A length cut to whole float pitches [m]."""
    return round(int(length / probe.float_pitch + 1e-9) * probe.float_pitch, 6)


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
        place, listed = "contexts", []
        for k, given in enumerate(contexts):
            place = f"contexts[{k}]"
            listed.append(given if isinstance(given, Context) else Context.model_validate(dict(given)))
    except ValidationError as error:
        raise ValueError(explain(error, "contexts" if isinstance(contexts, Mapping) else place)) from error
    except TypeError as error:
        raise ValueError(f"contexts = {contexts!r} is no name, list of contexts or mapping of ranges") from error
    if not listed:
        raise ValueError("contexts = [] is empty: give at least one")
    return tuple(listed)


def drawn_context(contexts: Contexts, rng: np.random.Generator, given: dict[str, Any]) -> Context:
    """A context from the generator, at random or from a list; ``given`` fixes fields or a whole "context".

    Takes "context" out of ``given``.

    Raises:
        ValueError: no such list, or a field that is not known or not valid.
    """
    source = checked_contexts(contexts)
    whole = given.pop("context", None)
    if whole is not None:
        values = whole.model_dump() if isinstance(whole, Context) else dict(whole)
        given = values | given
    if isinstance(source, Ranges):
        return draw_context(rng, given, source)
    return source[int(rng.integers(len(source)))].model_copy(update=given)
