"""Commands for what controllers can reach."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.processes.workers import Workers


@dataclass(frozen=True)
class Headroom:
    """Play planners, which try things out on the simulator, beside other policies: what feedback can still win."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ("tension-scheduled", "adaptive", "privileged", "ppo")
    """Policies and agents as of `evaluate`; the planners and best-schedule are played beside them."""
    settings: bool = False
    """Instead: the planner with other horizons, candidates and terminal values."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    limit: int = 12
    """How many of them, the first, which are balanced; 0: all."""
    fidelity: str = "fast"
    """How closely to simulate, the insertion and the copies that are tried."""
    tube: Path | None = None
    """Your own plant (tube.toml): its tubes and its map."""
    output: Path = Path("output/headroom")
    """Folder of the tables; episodes that are there already are not played again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Play, store, print."""
        from agents.evaluation.headroom import run_headroom, run_settings
        from agents.policies.places import place_at

        place = place_at(self.tube, self.contexts, self.limit)
        if self.settings:
            run_settings(place, self.fidelity, self.output, self.workers)
            print(f"written: {self.output}/ (settings.csv, settings.png, episodes.csv)")
            return
        run_headroom(self.policies, place, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (headroom.csv, headroom.png, episodes.csv)")


@dataclass(frozen=True)
class Plc:
    """A feedback law of ten constants: as structured text and table for your plant, or found anew."""

    st: Path | None = None
    """Write the law as IEC 61131-3 structured text here."""
    csv: Path | None = None
    """Write it as a table by helix diameter, friction and length here."""
    trimmed: bool = False
    """With --st: with integral action on the noise, as the policy trimmed-law acts."""
    tube: Path | None = None
    """Your own plant (tube.toml), whose bore, air, probe and ranges the law takes."""
    find: bool = False
    """Find the constants anew: on the vibration map, then in simulation on training tubes."""
    find_trim: bool = False
    """Find the two constants of trimmed-law anew: a grid of them, in simulation on training tubes."""
    trials: int = 600
    """With --find: laws tried on the map."""
    generations: int = 6
    """With --find: generations of ten laws each that are simulated then."""
    limit: int = 12
    """With --find and --find-trim: training tubes that are simulated, the first, which are balanced."""
    output: Path = Path("output/plc")
    """With --find and --find-trim: folder of plc-law.json or trimmed-law.json, every trial and the episodes."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Find, or write, or print."""
        from agents.policies.maps.vibration_map import stored_map
        from agents.policies.places import place_at
        from agents.policies.plc.law import PlantData, read_constants
        from agents.policies.plc.trimmed import read_trim
        from agents.policies.plc.writing import print_law, write_law

        if self.trimmed and not self.st:
            raise ValueError("trimmed = True needs --st: a table has no memory to trim with")
        if self.find_trim:
            from agents.policies.plc.trim_search import run_trim_search

            run_trim_search(self.limit, self.output, self.workers)
            print(f"written: {self.output}/ (trimmed-law.json, trimmed-law-trials.csv)")
            return
        constants = read_constants()
        if self.find:
            from agents.policies.plc.search import run_law_search

            constants = run_law_search(
                self.trials, self.generations, self.limit, self.output, self.workers, stored_map()
            )
            print(f"written: {self.output}/ (plc-law.json, plc-law-trials.csv)")
        place = place_at(self.tube, "test")
        trim = read_trim() if self.trimmed else None
        write_law(constants, PlantData.of(place.config), place, self.st, self.csv, trim)
        print_law(constants, trim)


@dataclass(frozen=True)
class World:
    """Find what the map leaves out, so that agents can train in it, and how far rewards there are off."""

    limit: int = 24
    """Training tubes that are recorded, the first, which are balanced."""
    simulated: Path = Path("results/evaluation/episodes.csv")
    """Episodes of an evaluation at fast on the test tubes, which rewards are compared with."""
    output: Path = Path("output/world")
    """Folder of map-world.json and map-world.csv."""

    def run(self) -> None:
        """Record, find, compare, print."""
        from agents.terminal.tables import print_table
        from agents.worlds.measure import HEADER, cells, run_world

        summary = run_world(self.limit, self.simulated, self.output)
        print_table("Rewards in the world of the map", HEADER, cells(summary), left=1)
        print(f"written: {self.output}/ (map-world.json, map-world.csv)")
