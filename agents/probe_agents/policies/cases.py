"""Evaluation cases: task, tubes and vibration map of a plant, or of the study's table 2 with the shipped tubes."""

import hashlib
import warnings
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from probe_agents.records.shipped import file_or_shipped
from probe_agents.terminal.names import checked_name, name_of
from probe_env import Context, Design, Plant
from probe_env.envs.contexts import SPLIT_SIZES, Split, spread_contexts
from probe_env.envs.plants import map_file, unusual
from probe_env.envs.task.config import ScoredPass, TaskConfig
from probe_env.envs.vibration_map import VibrationMap, load_for, stored_map
from probe_env.scene import whole_pitches


class PlantLabel(NamedTuple):
    """Name of the plant of a case.

    Attributes:
        name: of its file.
        digest: hash of the file's content.
        title: for tables and figures; empty for table 2.
    """

    name: str
    digest: str
    title: str


TABLE_2: Final = PlantLabel("table 2", "", "")


class EvaluationCase(NamedTuple):
    """An evaluation case: task, tubes, vibration map, and the plant; None: table 2's."""

    config: TaskConfig
    contexts: tuple[Context, ...]
    vibration: VibrationMap
    plant: Plant | None = None
    plant_label: PlantLabel = TABLE_2


def plant_at(plant_file: Path | None) -> Plant | None:
    """Read a plant by its file, or by the name of a shipped one; None for None. Warns of ``unusual`` values."""
    plant = None if plant_file is None else Plant.from_toml(file_or_shipped("tubes", plant_file))
    for note in unusual(plant) if plant else ():
        warnings.warn(f"{plant_file}: {note}", stacklevel=2)
    return plant


def map_of(plant_file: Path | None, plant: Plant | None) -> VibrationMap:
    """Read the vibration map next to a plant's file; the shipped map if there is none.

    Raises:
        FileError: the map is damaged, or its bore, length, probe, air or assumptions differ from the file.
    """
    if plant_file is None or plant is None:
        return stored_map()
    try:
        path = map_file(file_or_shipped("tubes", plant_file))
    except FileNotFoundError:  # a file that is not written yet may have its map already
        path = map_file(plant_file)
    return load_for(path, plant_file.name, plant.scene) if path.exists() else stored_map()


def with_probe(config: TaskConfig, name: str) -> TaskConfig:
    """The task with a probe of ``configs/design/``; floats are limited by the bore, the cable by the helix."""
    design = Design.from_toml(file_or_shipped("design", name)).cut_to(config.scene)
    design.check_whole_pitches()
    probe = design.probe(config.scene.probe)
    room = whole_pitches(config.scene.tube.helix_length - probe.guide_length, probe)
    carrier = min(config.scene.carrier_length, max(room, probe.float_pitch))
    return config.model_copy(update={"scene": {"probe": probe, "carrier_length": carrier}})


def read_case(
    plant_file: Path | None,
    split: Split,
    limit: int = 0,
    passes: Literal["in", "both"] | None = None,
    scored_pass: ScoredPass | None = None,
) -> EvaluationCase:
    """``load_case`` of a plant's file, or of the name of a shipped one, with the vibration map next to it."""
    plant = plant_at(plant_file)
    if plant_file is None or plant is None:
        return load_case(None, split, limit, passes, scored_pass)
    case = load_case(plant, split, limit, passes, scored_pass, map_of(plant_file, plant))
    name = checked_name(name_of(plant_file), "a tube's file is called")
    bore, length = 1e3 * plant.tube.inner_diameter, plant.tube.helix_length
    digest = hashlib.sha256(plant.model_dump_json().encode()).hexdigest()[:12]
    return case._replace(plant_label=PlantLabel(name, digest, f"{name} (bore {bore:g} mm, helix {length:g} m)"))


def load_case(
    plant: Plant | None,
    split: Split,
    limit: int = 0,
    passes: Literal["in", "both"] | None = None,
    scored_pass: ScoredPass | None = None,
    vibration: VibrationMap | None = None,
) -> EvaluationCase:
    """The case of a shipped list of tubes, or of as many tubes sampled from a plant's ranges; each list has its own.

    Args:
        plant: the plant; None: table 2's, in the shipped lists.
        split: "train", "validation" or "test".
        limit: number of tubes, from the start of the list; 0: all.
        passes: "in", or "both" with twice the time limit; default: as in the plant's file.
        scored_pass: pass that is scored if passes = "both"; default: as in the file, or the better one.
        vibration: vibration map; default: the shipped one.
    """
    max_tubes = SPLIT_SIZES[split]
    if plant is None:
        config, contexts = TaskConfig(), spread_contexts(split, limit)
    elif 0 <= limit <= max_tubes:
        config, contexts = plant.config, plant.contexts(limit or max_tubes, tuple(SPLIT_SIZES).index(split))
    else:
        raise ValueError(f"limit = {limit!r} is outside the accepted range 0 (all) to {max_tubes}")
    update: dict[str, Any] = {"scored_pass": scored_pass} if scored_pass else {}
    if (passes or config.passes) == "in":
        if scored_pass:
            raise ValueError(f"scored_pass = {scored_pass!r} needs --passes both: without it there is no withdrawal")
        update = {"passes": passes} if passes else {}
    elif not config.returns:
        update = {"passes": "both", "scored_pass": scored_pass or "best", "time_limit": 2.0 * config.time_limit}
    config = config.model_copy(update=update) if update else config
    return EvaluationCase(config, contexts, vibration or stored_map(), plant)
