"""Start of an episode: tube, probe and inserted length, from arguments or sampled."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal, TypedDict, get_args

import numpy as np
from pydantic import ValidationError

from probe_env.design import RANGES, Design
from probe_env.envs.contexts import SPLIT_SIZES, Context, Ranges, Split, draw_context, load_contexts
from probe_env.envs.plants import PlantSource, map_file, plant_of
from probe_env.envs.task.config import TaskConfig, scene_of, ungrouped
from probe_env.envs.vibration_map import VibrationMap
from probe_env.fidelity import Fidelity
from probe_env.scene import Scene, whole_pitches
from probe_env.settings import closest, explain, tuples

NamedContexts = Literal["random"] | Split
Contexts = NamedContexts | Sequence[Context | Mapping[str, float]] | Mapping[str, Any]
"""A name, a custom list, or ranges of random contexts (see ``contexts.Ranges``)."""
Probes = Literal["scene", "random"]
SHORTEST_START: Final = 5.0  # [m] inserted
SETTLING: Final = (0.2, 63.0 / 3600.0)
"""Default feed speed [m/s] and air supply [m3/s] while the probe settles, clipped to the range of the task."""
WITHDRAWAL_SCENE: Final[dict[str, Any]] = {"couple": "tangent", "contact": {"cable": True}}
"""Fields of the scene that withdrawal needs: the cable is under compression."""
CARRIER_AT_START: Final = 2.5  # [m], at least
RANDOM_TUBES: Final = 1024
"""Number of tubes of a plant from which a random context is sampled."""


class SceneSettings(TypedDict, total=False):
    """Arguments that select tube, scene and fidelity; see ``InsertionEnv``."""

    tube: PlantSource
    scene: Scene | Mapping[str, Any] | None
    fidelity: str | Fidelity | Mapping[str, Any]
    contexts: Contexts


class EpisodeSettings(SceneSettings, total=False):
    """Arguments of episodes besides the task, SI units; see ``InsertionEnv``."""

    feed_speed: float | None
    air_supply_rate: float | None
    probes: Probes
    in_turn: bool
    surrogate_map: VibrationMap | str | Path | None


DEFAULTS: Final[EpisodeSettings] = {
    "tube": None, "scene": None, "fidelity": "fast", "contexts": "random",
    "feed_speed": None, "air_supply_rate": None, "probes": "scene",
    "in_turn": False, "surrogate_map": None,
}  # fmt: skip


@contextmanager
def restored_on_error(rngs: Iterable[np.random.Generator]) -> Iterator[None]:
    """Restore the state of the generators if the block raises."""
    before = [(rng, rng.bit_generator.state) for rng in rngs]
    try:
        yield
    except BaseException:
        for rng, state in before:
            rng.bit_generator.state = state
        raise


class EpisodeSampler:
    """Samples tube and probe of an episode, see ``EpisodeSettings``; ValueError for arguments that are not valid.

    Attributes:
        source: tubes, or ranges to sample them from.
        feed_speed, air_supply_rate: while the probe settles [m/s], [m3/s].
    """

    def __init__(
        self,
        config: TaskConfig,
        contexts: Contexts,
        probes: Probes = "scene",
        feed_speed: float | None = None,
        air_supply_rate: float | None = None,
        in_turn: bool = False,
    ) -> None:
        if probes not in get_args(Probes):
            raise ValueError(f"probes = {probes!r} is not one of {', '.join(get_args(Probes))}")
        self.config, self.probes, self.in_turn, self.source = config, probes, in_turn, checked_contexts(contexts)
        if in_turn and isinstance(self.source, Ranges):
            raise ValueError(
                f"in_turn = True needs a list of tubes: contexts = {', '.join(map(repr, SPLIT_SIZES))} or your own"
            )
        low, high = np.array([config.feed_speeds, config.air_supply_rates]).T
        feed, air = np.clip(SETTLING, low, high).tolist()
        self.feed_speed = feed if feed_speed is None else feed_speed
        self.air_supply_rate = air if air_supply_rate is None else air_supply_rate

    @property
    def scene(self) -> Scene:
        """Base scene, before context and options are applied."""
        return self.config.scene

    @property
    def stiffest(self) -> Scene:
        """Scene with the stiffest contact and lightest floats: a step stable for it is stable for all samples."""
        source = self.source
        stiffness = source.stiffest if isinstance(source, Ranges) else max(c.contact_stiffness for c in source)
        update: dict[str, Any] = {"contact": {"stiffness": max(stiffness, self.scene.contact.stiffness)}}
        if self.probes == "random":
            lightest = {name: RANGES[name][0] for name in ("line_density", "float_pitch")}
            probe = Design.model_validate(lightest).cut_to(self.scene).probe(self.scene.probe)
            update |= {"probe": probe, "carrier_length": whole_pitches(self.scene.carrier_length, probe)}
        return self.scene.model_copy(update=update | (WITHDRAWAL_SCENE if self.config.returns else {}))

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any], turn: int) -> tuple[Context, Scene]:
        """Context and scene of an episode; ``options`` of ``Episodes.reset`` do not change the random numbers.

        ``turn`` is the index of the tube with ``in_turn``; after the last tube the first follows.
        """
        fixed = reset_options(options)
        changes: dict[str, Any] = {name: fixed.pop(name) for name in ("probe", "carrier_length") if name in fixed}
        source = self.source
        if self.in_turn and not isinstance(source, Ranges):
            source = (source[turn % len(source)],)
        context = sample_context(source, rng, fixed)
        design = Design.random(rng).cut_to(self.scene).built.model_dump() if self.probes == "random" else {}
        probe = changes.get("probe", {})
        if not isinstance(probe, Mapping):
            raise ValueError(f"options['probe'] = {probe!r} is not a mapping of fields of the probe")
        changes["probe"] = design | dict(probe)
        return context, self.build(context, changes)

    def build(self, context: Context, changes: Mapping[str, Any]) -> Scene:
        """Scene at the start of an episode: context, probe, initial length, feed and air while settling."""
        scene = context.apply(self.scene.model_copy(update=WITHDRAWAL_SCENE) if self.config.returns else self.scene)
        if self.config.growing and "carrier_length" in changes:
            raise ValueError("carrier_length is not an option here: the probe starts short and is fed in")
        probe = scene.probe.model_copy(update=changes.get("probe", {}))
        carrier = changes.get("carrier_length", scene.carrier_length)
        if self.probes == "random":  # with any pitch
            carrier = whole_pitches(carrier, probe)
        if self.config.growing:
            start = max(SHORTEST_START, probe.guide_length + CARRIER_AT_START)
            carrier = round((start - probe.guide_length) / probe.float_pitch) * probe.float_pitch
        settled = {"feed_speed": self.feed_speed, "air_supply_rate": self.air_supply_rate}
        return scene.model_copy(update={"probe": probe, "carrier_length": carrier} | settled)


def resolve_settings(
    defaults: Mapping[str, Any], config: TaskConfig | Mapping[str, Any] | None, settings: EpisodeSettings
) -> tuple[TaskConfig, EpisodeSettings]:
    """The task with its scene, and the remaining settings: contexts, fidelity and others.

    Args:
        defaults: fields of the task that the environment changes.
        config: changed fields of the task, or a whole task.
        settings: arguments, with a ``tube`` or a ``scene``.
    """
    for name in settings:
        if name in TaskConfig.model_fields and name != "scene":
            raise TypeError(f"{name} is a field of the task: give config={{{name!r}: ...}}")
    contexts = settings.get("contexts")
    if settings.get("tube") is not None and isinstance(contexts, str) and contexts in SPLIT_SIZES:
        raise ValueError(
            f"contexts = {contexts!r} cannot be combined with tube: leave contexts out, to sample them from its"
            " ranges, or give your own Contexts"
        )
    remaining = settings.copy()
    file = remaining.get("tube")
    if isinstance(file, str | Path) and map_file(Path(file)).exists():
        remaining.setdefault("surrogate_map", map_file(Path(file)))
    plant, scene = plant_of(remaining.pop("tube", None)), remaining.pop("scene", None)
    if plant is None:
        task = config
        if not isinstance(task, TaskConfig):  # JSON has no tuples
            task = TaskConfig.model_validate(tuples(dict(defaults) | ungrouped(dict(config or {}))))
        return (task if scene is None else task.model_copy(update={"scene": scene_of(scene)})), remaining
    if scene is not None:
        raise ValueError("tube and scene: give one of them, a tube has its own scene")
    if isinstance(config, TaskConfig):
        raise ValueError("config with a tube must be a mapping of changed fields: a tube has its own task")
    if remaining.get("contexts", "random") == "random":
        remaining["contexts"] = plant.contexts(RANDOM_TUBES)
    return plant.configured(defaults, config) if defaults or config else plant.config, remaining


def checked_contexts(contexts: Contexts) -> tuple[Context, ...] | Ranges:
    """A list of contexts, or ranges to sample from."""
    if isinstance(contexts, Ranges) or (isinstance(contexts, tuple) and all(isinstance(c, Context) for c in contexts)):
        return contexts
    if isinstance(contexts, str):
        if contexts == "random":
            return Ranges()
        if contexts not in get_args(Split):
            names = ("random", *get_args(Split))
            raise ValueError(f"contexts = {contexts!r} is not one of {', '.join(names)}{closest(contexts, names)}")
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


def reset_options(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """A copy of the options of ``reset``; ValueError if they are not a mapping."""
    if not isinstance(options or {}, Mapping):
        raise ValueError(f"options = {options!r} is not a mapping from names to values")
    return dict(options or {})


def sample_context(source: tuple[Context, ...] | Ranges, rng: np.random.Generator, fixed: dict[str, Any]) -> Context:
    """A context from ranges or from a list; ``fixed`` sets fields, or a whole "context", which is removed from it."""
    whole = fixed.pop("context", None)
    if whole is not None:
        if not isinstance(whole, Context | Mapping):
            raise ValueError(f"options['context'] = {whole!r} is neither a Context nor a mapping of its fields")
        fixed = dict(whole) | fixed
    if isinstance(source, Ranges):
        return draw_context(rng, fixed, source)
    return source[int(rng.integers(len(source)))].model_copy(update=fixed)
