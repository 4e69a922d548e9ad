"""Evaluation cases: task, tubes and vibration map of a plant, or of table 2 with the shipped lists of tubes."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final, Literal, NamedTuple

from agents.records.shipped import file_or_shipped
from agents.terminal.names import checked_name, name_of
from probe_env import Context, Design, Plant
from probe_env.envs.contexts import SPLIT_SIZES, Split, spread_contexts
from probe_env.envs.plants import map_beside
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import VibrationMap, load_for, stored_map
from probe_env.scene import whole_pitches


class Named(NamedTuple):
    """The plant of a case.

    Attributes:
        name: of its file.
        digest: hash of the file's content.
        title: for tables and figures; empty for table 2.
    """

    name: str
    digest: str
    title: str


TABLE_2: Final = Named("table 2", "", "")


class EvaluationCase(NamedTuple):
    """An evaluation case: task, tubes, vibration map, and the plant."""

    config: TaskConfig
    contexts: tuple[Context, ...]
    vibration: VibrationMap
    tube: Named = TABLE_2


def case_of(plant: Plant | None, split: Split, limit: int = 0, vibration: VibrationMap | None = None) -> EvaluationCase:
    """A shipped list of tubes, or as many tubes sampled from the ranges of a plant, others for each list.

    Args:
        plant: the plant; None: table 2's, in the shipped lists.
        split: which list.
        limit: number of tubes, the first of the list; 0: all.
        vibration: the map; default: the shipped one.

    Raises:
        ValueError: no such list, or a limit out of range.
    """
    vibration, most = vibration or stored_map(), SPLIT_SIZES[split]
    if plant is None:
        return EvaluationCase(TaskConfig(), spread_contexts(split, limit), vibration)
    if not 0 <= limit <= most:
        raise ValueError(f"limit = {limit!r} is outside the accepted range 0 (all) to {most}")
    return EvaluationCase(plant.configured(), plant.contexts(limit or most, tuple(SPLIT_SIZES).index(split)), vibration)


def plant_at(tube: Path | None) -> Plant | None:
    """A plant by its file, or by the name of one that ships.

    Raises:
        FileNotFoundError: neither.
        ValueError: the file is not valid.
    """
    return None if tube is None else Plant.from_toml(file_or_shipped("tubes", tube))


def map_of(tube: Path | None, plant: Plant | None) -> VibrationMap:
    """The map beside a plant's file, where there is one, else the shipped one.

    Raises:
        FileError: the map is damaged, or of another bore, length, probe or air than the file now says.
    """
    if tube is None or plant is None:
        return stored_map()
    try:
        path = map_beside(file_or_shipped("tubes", tube))
    except FileNotFoundError:  # a file that is not written yet may have its map already
        path = map_beside(tube)
    return load_for(path, tube.name, plant.scene) if path.exists() else stored_map()


def with_probe(config: TaskConfig, name: str) -> TaskConfig:
    """The task with a probe of ``configs/design/``, its floats cut to what fits the bore, its cable to the helix.

    Raises:
        FileNotFoundError: no such design.
        ValueError: no float fits.
    """
    design = Design.from_toml(file_or_shipped("design", name)).cut_to(config.scene)
    probe = design.probe(config.scene.probe)
    room = whole_pitches(config.scene.tube.helix_length - probe.guide_length, probe)
    carrier = min(config.scene.carrier_length, max(room, probe.float_pitch))
    return config.model_copy(update={"scene": {"probe": probe, "carrier_length": carrier}})


def both_ways(case: EvaluationCase, inspects: str) -> EvaluationCase:
    """The same case with a task of both passes and twice the time; ``inspects`` as in ``TaskConfig``."""
    update = {"passes": "both", "inspects": inspects, "time_limit": 2.0 * case.config.time_limit}
    return case._replace(config=case.config.model_copy(update=update))


def load_case(
    tube: Path | None,
    split: Split,
    limit: int = 0,
    passes: Literal["in", "both"] | None = None,
    inspects: Literal["in", "back", "best"] | None = None,
) -> EvaluationCase:
    """The task, tubes and map of a plant, or of the shipped lists, for the passes to be made.

    Args:
        tube: file or name of a plant; None: the shipped lists.
        split: which tubes.
        limit: number of tubes, the first of the list; 0: all.
        passes: "in" or "both"; default: what the plant's file says.
        inspects: the pass that is scored with both passes; default: what the file says, or the better one.

    Raises:
        FileNotFoundError: no such file.
        ValueError: an argument or a file is not valid.
    """
    plant = plant_at(tube)
    case = case_of(plant, split, limit, map_of(tube, plant))
    if tube is not None and plant is not None:
        name = checked_name(name_of(tube), "a tube's file is called")
        bore, length = 1e3 * plant.tube.inner_diameter, plant.tube.helix_length
        digest = hashlib.sha256(plant.model_dump_json().encode()).hexdigest()[:12]
        case = case._replace(tube=Named(name, digest, f"{name} (bore {bore:g} mm, helix {length:g} m)"))
    if (passes or case.config.passes) == "in":
        if inspects:
            raise ValueError(f"inspects = {inspects!r} needs --passes both: the probe is not drawn back")
        return case._replace(config=case.config.model_copy(update={"passes": "in"}))
    if not case.config.returns:
        return both_ways(case, inspects or "best")
    update = {"inspects": inspects} if inspects else {}
    return case._replace(config=case.config.model_copy(update=update))
