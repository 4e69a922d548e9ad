"""Commands of feed control: evaluate, search, film."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.processes.workers import Workers


@dataclass(frozen=True)
class Evaluate:
    """Evaluate policies on the same tubes: KPIs with intervals, paired differences, a table and a report."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ("constant", "slow", "slow-down", "pi")
    """Policies and trained agents by name (probe-env agents lists them; ppo@2 is another training seed), schedule files
    (.csv, .toml), feedback laws (.json) or agents' bundles (.npz). NAME=FILE names one, NAME@K=FILE the training seeds
    of one method. shielded:POLICY blows more where its feed and air would leave too little drive."""
    probes: Literal["scene", "random"] = "scene"
    """scene: the study's probe; random: one for every tube and seed, drawn from the design space."""
    against: str | None = None
    """Policy that the others are compared with; default: the first."""
    output: Path = Path("output/evaluation")
    """Folder of the tables and the report; what is there already is not run again."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    limit: int = 0
    """Take so many tubes of the list only, the first of it, which are balanced; 0: all."""
    seeds: int = 1
    """Seeds of sensor noise and start for every tube."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast, one of version 0 (fast-v0), auto or auto:TOLERANCE;
    with --passes both study, standard, unlapsed or fast, which has time-lapse on the way in alone. Or settings in
    braces, as errors advise them."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    check_fidelity: Literal["no", "half-step", "replayed", "acting", "all"] = "no"
    """Repeat at half the time step; and with a finer fidelity: what was fed and blown replayed (on the way in alone),
    the policies themselves acting, or both."""
    finer: str = "reference"
    """The finer fidelity of the check. reference costs some sixteen times fast; study hours and more."""
    tube: Path | None = None
    """Your own plant (tube.toml): its task, and as many tubes drawn from what is known of it instead of the list."""
    strict: bool = False
    """Refuse policies that were not made for these tubes, instead of saying so."""
    passes: Literal["in", "both"] | None = None
    """Default: in, or what the tube's file says. both: feed the probe in and draw it back. Policies are for the way in;
    schedule files may have columns for the way back (return_feed_speed_m_per_s, return_air_supply_m3_per_h), others
    come back as fast as the device can. Agents that were trained for both passes act on both."""
    inspects: Literal["in", "back", "best"] | None = None
    """What a metre counts for with --passes both: the way in, the way back, or the better of both (default)."""

    def run(self) -> None:
        """Run what is missing, print, write the report."""
        from agents.evaluation.fidelity_check import Checks
        from agents.evaluation.report import evaluate, plan_of
        from agents.policies.both_ways import check_goes_back, fidelity_of, way_in
        from agents.policies.catalogue import own_policies
        from agents.policies.places import both_ways, looking, place_at
        from agents.terminal.fidelities import fidelity_given

        place = place_at(self.tube, self.contexts, self.limit)
        fidelity, finer = fidelity_given(self.fidelity), fidelity_given(self.finer, "finer")
        passes = self.passes or place.config.passes
        if passes == "both":
            place = looking(place, self.inspects) if place.config.returns else both_ways(place, self.inspects or "best")
            if isinstance(fidelity, str):
                fidelity = fidelity_of(fidelity)
            if isinstance(finer, str) and self.check_fidelity in ("replayed", "acting", "all"):
                check_goes_back("finer", finer)
                finer = fidelity_of(finer)
        elif self.inspects:
            raise ValueError(f"inspects = {self.inspects!r} needs --passes both: the probe is not drawn back")
        else:
            place = place._replace(config=way_in(place.config))
        plan = plan_of(self.policies, place, self.seeds, fidelity, self.probes, self.strict)
        checks = Checks(self.check_fidelity, finer)
        evaluate(plan, self.output, checks, self.against, self.workers, own_policies(self.policies))


@dataclass(frozen=True)
class Agents:
    """List the trained agents that ship: name, what each sees, what it was trained for, training seeds."""

    def run(self) -> None:
        """Print."""
        from agents.policies.catalogue import NAMES
        from agents.policies.trained import print_agents
        from agents.records.shipped import shipped_names
        from agents.terminal.tables import print_terms

        print_agents()
        print("Other policies")
        print_terms({"by name": ", ".join(NAMES), "schedules": ", ".join(shipped_names("schedules"))})


@dataclass(frozen=True)
class Report:
    """Write the report of a stored evaluation again, or of what an interrupted one has stored: one HTML page."""

    folder: tyro.conf.Positional[Path] = Path("output/evaluation")
    """Folder of the evaluation; by default that of `evaluate`."""

    def run(self) -> None:
        """Write report.html, and summary.csv beside whole tables."""
        from agents.evaluation.report import write_report

        print(f"written: {write_report(self.folder)}")


@dataclass(frozen=True)
class Tradeoff:
    """Sweep one parameter of every policy family: the front of inspection time against vibration."""

    families: tyro.conf.Positional[tuple[str, ...]] = ("constant", "slow-down", "on-off", "pi", "tension-scheduled")
    """Families to sweep."""
    output: Path = Path("output/tradeoff")
    """Folder of the tables and the figure; what is there already is not run again."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    beside: tuple[str, ...] = ()
    """Single policies to draw beside the fronts: schedules, agents."""
    limit: int = 12
    """Take so many tubes of the list only, the first of it, which are balanced; 0: all."""
    fidelity: str = "fast"
    """How closely to simulate: study, reference, standard, fast, one of version 0 (fast-v0), auto or auto:TOLERANCE."""
    tube: Path | None = None
    """Your own plant (tube.toml), see `probe-env evaluate --help`."""

    def run(self) -> None:
        """Run what is missing, store, print."""
        from agents.evaluation.tradeoff import run_tradeoff
        from agents.policies.places import place_at

        place = place_at(self.tube, self.contexts, self.limit)
        run_tradeoff(self.families, self.output, place, self.fidelity, self.beside)


@dataclass(frozen=True)
class Map:
    """Wander on the training tubes and fit how loud the probe is over length, feed, air and tube."""

    seeds: int = 2
    """Insertions on each of the 96 training tubes."""
    output: Path = Path("output/map")
    """Folder of the insertions; what is there already is not run again."""
    target: Path | None = None
    """File of the map (.npz), how it was made beside it (.json); default: vibration-map.npz in the output folder, with
    --tube NAME.toml NAME-map.npz beside that file, where every command with that tube finds it, unless the file is one
    that ships."""
    tube: Path | None = None
    """Your own plant (tube.toml): 96 tubes drawn from what is known of it instead of the training list."""

    def run(self) -> None:
        """Run what is missing, fit, store."""
        import_module("torch")  # for the fit, which comes after half an hour of simulation

        from agents.policies.maps.fit import make_map
        from agents.policies.places import plant_at

        target = self.target or self._default_target()
        if target.suffix != ".npz":
            raise ValueError(f"target = {str(target)!r} is not a file of arrays (.npz)")
        make_map(self.seeds, self.output, target, plant_at(self.tube))
        print(f"written: {target}")

    def _default_target(self) -> Path:
        """Beside the tube's file, or in the output folder where there is none, or one that ships: its map stays."""
        from agents.policies.places import map_beside
        from agents.records.shipped import file_or_shipped, ships

        target = self.output / "vibration-map.npz"
        if self.tube is None:
            return target
        if not ships("tubes", file_or_shipped("tubes", self.tube)):
            return map_beside(self.tube)
        print(f"probe-env: note: {self.tube} ships, and its map stays: the new one is {target}", file=sys.stderr)
        return target


@dataclass(frozen=True)
class Optimise:
    """Find the best constant feed or the best schedule over length for the training tubes, by CMA-ES on the map."""

    families: tyro.conf.Positional[tuple[str, ...]] = ()
    """What to search: best-constant, best-schedule, best-schedule-dDIAMETER; none: all."""
    trials: int = 1200
    """Schedules tried in each search."""
    output: Path | None = None
    """Folder of the schedules, their trials and how they were made; default: output/optimise, with --tube NAME.toml
    output/optimise-NAME."""
    work: Path | None = None
    """Folder of the simulated episodes; what is there already is not run again. Default: simulated in the output
    folder."""
    vibration_map: Path | None = None
    """File of the map (.npz), see `probe-env map`; default: the one beside the tube's file, or the shipped one."""
    tube: Path | None = None
    """Your own plant (tube.toml): searched for and simulated in its tubes."""

    def run(self) -> None:
        """Search, simulate on the validation tubes, store, print."""
        from agents.policies.maps.search import FAMILIES, OF_A_PLANT, run_search
        from agents.policies.maps.vibration_map import VibrationMap, stored_map
        from agents.policies.places import map_of, plant_at

        for family in self.families:
            if family not in FAMILIES:
                raise ValueError(f"family = {family!r} is not one of {', '.join(FAMILIES)}")
        plant = plant_at(self.tube)
        vibration = VibrationMap.load(self.vibration_map) if self.vibration_map else map_of(self.tube, plant)
        output = self.output or Path(f"output/optimise-{self.tube.stem}" if self.tube else "output/optimise")
        if self.tube and vibration is stored_map():
            print(f"no map of {self.tube} is there: searched on the shipped one, of table 2's bore and air")
        searched = self.families or tuple(FAMILIES if plant is None else OF_A_PLANT)
        for family in searched:
            run_search(family, self.trials, output, self.work or output / "simulated", vibration, plant)
        files = ", ".join(f"{family}.csv" for family in searched)
        print(f"written: {output}/ ({files}: schedules to evaluate; of each the trials and how it was made)")


@dataclass(frozen=True)
class Render:
    """Film a probe under a policy: an episode, or the motion near its tip in slow motion."""

    output: Path = Path("output/insertion.gif")
    """File to write: .gif, .mp4, or .png for the last picture alone."""
    view: Literal["helix", "strip"] = "helix"
    """helix: a whole episode, the helix with the probe in it, feed, air, vibration, reward; strip: the tube unrolled
    near the tip, 8 times slowed, with walls, floats, contacts and the sensor's motion."""
    env_id: Literal[
        "probe_env/Insertion-v1",
        "probe_env/Snapshot-v1",
        "probe_env/Inspection-v0",
        "probe_env/Insertion-v0",
        "probe_env/Snapshot-v0",
    ] = "probe_env/Insertion-v1"
    """Which environment; version 0 has the coarser mesh of before."""
    policy: str = "constant"
    """Policy or trained agent by name, schedule file or agent's bundle."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast (for Insertion-v1 alone) or auto."""
    contexts: Literal["random", "train", "validation", "test"] = "random"
    """Shipped list that the tube is drawn from; random: from the ranges that the lists were drawn from."""
    every: int = 4
    """Of the helix, control periods a frame: of 1 s in Insertion-v1, 0.1 s in Snapshot-v1."""
    at: float | None = None
    """Of the strip, the inserted length at which it begins [m]; default: three quarters of the helix."""
    length: float = 10.0
    """Of the strip, how far behind the tip it reaches [m]."""
    duration: float = 0.5
    """Of the strip, how much of the probe's motion it shows [s], up to 2; a picture each 5 ms."""
    seed: int = 0
    """Of the tube and the sensors' noise."""
    tube: Path | None = None
    """Your own plant (tube.toml), of which a random tube is drawn."""

    def run(self) -> None:
        """Simulate, draw, write."""
        from agents.evaluation.film import Look, render_episode, render_strip
        from agents.policies.places import plant_at

        if self.at is not None and self.view != "strip":
            raise ValueError(f"at = {self.at!r} m is of the strip: add --view strip")
        of = {"tube": plant_at(self.tube), "fidelity": self.fidelity, "contexts": self.contexts}
        if self.view == "strip":
            look = Look(self.at, self.length, self.duration)
            figures = render_strip(self.env_id, self.output, self.policy, self.seed, look, **of)
        else:
            figures = render_episode(self.env_id, self.output, self.policy, self.every, self.seed, **of)
        for name, value in figures.items():
            print(f"{name:40s} {value:.6g}")
        print(f"written: {self.output}")
