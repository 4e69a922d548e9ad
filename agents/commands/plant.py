"""Commands for a plant of one's own: what its logs tell, and which schedule is best for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.processes.workers import Workers
from agents.terminal.names import name_of


@dataclass(frozen=True)
class Calibrate:
    """Learn friction, contact stiffness, drag and damping of your plant from its logs, with intervals and a verdict."""

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Logs of insertions (see `probe-env log`), or the name of one that ships: example-rig. Each needs one at least of
    root tension, radial and axial acceleration, eddy-current noise."""
    tube: Path | None = None
    """Your plant (tube.toml) with what is known beforehand; default: table 2's, and nothing known."""
    output: Path = Path("output/calibration")
    """Folder of calibration.json, corner.png and bands.png."""
    helix_diameters: tuple[float, ...] = ()
    """Of the tube of each log [m], or one for all; needed where the file lists several."""
    tubes: tuple[str, ...] = ()
    """Name of the tube of each log: logs of one tube share its friction. Default: one tube, or one for each helix
    diameter."""
    columns: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="HEAD=QUANTITY[UNIT]")]] = ()
    """What columns are whose heads are not known, see `probe-env log --help`."""

    def run(self) -> None:
        """Read, sample, store, print."""
        for needed in ("emcee", "corner"):  # before half a minute of sampling
            import_module(needed)

        from agents.plant.calibration import calibrate, draw_bands, draw_corner, print_calibration, recorded_of
        from agents.plant.response import stored_response
        from agents.policies.places import plant_at
        from agents.records.provenance import provenance, write_json
        from probe_env import Plant

        plant = plant_at(self.tube) or Plant()
        recorded = recorded_of(self.logs, plant, self.helix_diameters, self.tubes, self.columns)
        response = stored_response()
        calibration = calibrate(recorded, plant, response, str(self.tube or "tube"))
        target = self.output / "calibration.json"
        write_json(target, calibration.to_json() | {"provenance": provenance()})
        pictures = [
            draw_corner(calibration, self.output / "corner.png"),
            draw_bands(calibration, response, self.output / "bands.png"),
        ]
        print_calibration(calibration, own=self.tube is not None)
        print(f"written: {', '.join(map(str, (target, *pictures)))}")
        if calibration.misfits:
            print("it is not for use: a tube.toml that names it is warned of")
        else:
            print(f'use it: posterior = "{target}" above the tables of your tube.toml')


@dataclass(frozen=True)
class Recommend:
    """Recommend a schedule for your plant: the best expected over what is known of it, and simulated against others."""

    schedules: tyro.conf.Positional[tuple[str, ...]] = ()
    """Schedules of your own to compare it with (.csv), as `probe-env evaluate` takes them; best-schedule and
    tension-scheduled are compared in any case."""
    tube: Path | None = None
    """Your plant (tube.toml), best with the posterior of a calibration; default: table 2's in the shipped lists."""
    output: Path = Path("output/recommended.csv")
    """The schedule, which `probe-env evaluate` takes; how it was found beside it (.json)."""
    policy: Path | None = None
    """File (.json) of the feedback law for this plant, which reads the friction from the root tension: a table over
    helix diameter, friction and inserted length, which `probe-env evaluate` takes; default: none."""
    folder: Path | None = None
    """Folder of the simulated episodes and the page (report.html); default: NAME-confirmed beside the output."""
    limit: int = 24
    """Tubes on which it is simulated, drawn anew from what is known; 0: all of them."""
    simulated: bool = True
    """Whether it is simulated against others at all."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast or auto."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Search, store, simulate, print."""
        from agents.plant.recommendation import Confirmation, recommend
        from agents.plant.response import stored_response
        from agents.policies.places import plant_at

        if self.output.suffix != ".csv":
            raise ValueError(f"output = {str(self.output)!r} is not a CSV file (.csv), which schedules are")
        if self.policy and self.policy.suffix != ".json":
            raise ValueError(f"policy = {str(self.policy)!r} is not a JSON file (.json), which feedback laws are")
        folder = self.folder or self.output.with_name(f"{self.output.stem}-confirmed")
        if self.schedules and not self.simulated:
            raise ValueError("schedules: only a simulation compares with them; leave out --no-simulated")
        confirmation = Confirmation(folder, self.schedules, self.limit, self.fidelity) if self.simulated else None
        recommend(plant_at(self.tube), self.output, confirmation, stored_response(), self.policy, self.workers)


@dataclass(frozen=True)
class Learn:
    """Learn what calibrations and recommendations go by: wandering insertions, and a network of what they felt."""

    groups: Annotated[int, tyro.conf.arg(aliases=("--limit",))] = 15
    """How many, of 32 insertions each, in one bore."""
    fidelity: Literal["fast", "standard"] = "standard"
    """How closely they are simulated."""
    output: Path = Path("output/response")
    """Folder of the insertions; what is there already is not run again."""
    target: Path | None = None
    """File of the response (.npz), how it was made beside it (.json); default: response.npz in the output folder."""

    def run(self) -> None:
        """Simulate what is missing, learn, store."""
        import_module("torch")  # for the network, which comes after hours of simulation

        from agents.calibration.simulated.fit import make_response

        target = self.target or self.output / "response.npz"
        if target.suffix != ".npz":
            raise ValueError(f"target = {str(target)!r} is not a file of arrays (.npz)")
        make_response(self.groups, self.fidelity, self.output, target)
        print(f"written: {target}")


@dataclass(frozen=True)
class Calibrations:
    """Calibrate simulated logs whose truth is known: coverage, errors, ranks, and logs of another world."""

    logs: Annotated[int, tyro.conf.arg(aliases=("--limit",))] = 40
    """How many, in groups of 8 of one bore and length."""
    fidelity: Literal["fast", "standard"] = "standard"
    """How closely they are simulated."""
    output: Path = Path("output/calibrations")
    """Folder of the tables; groups that are there already are not run again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Simulate, calibrate, store, print."""
        import_module("emcee")  # for the calibrations, which come after the simulated logs

        from agents.calibration.simulated.study import run_study

        run_study(self.logs, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (calibrations.csv, summary.json)")


@dataclass(frozen=True)
class Recommendations:
    """Recommend schedules for simulated tubes after one log of each, and simulate them against knowing the tube."""

    tubes: Annotated[int, tyro.conf.arg(aliases=("--limit",))] = 24
    """How many, in groups of 8 of one bore and length."""
    fidelity: Literal["fast", "standard"] = "standard"
    """How closely the schedules are simulated; the logs are simulated with standard."""
    output: Path = Path("output/recommendations")
    """Folder of the tables; groups that are there already are not run again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Simulate, calibrate, recommend, store, print."""
        import_module("emcee")  # for the calibrations, which come after the simulated logs

        from agents.recommendation.study import run_study

        run_study(self.tubes, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (recommendations.csv, summary.json)")


@dataclass(frozen=True)
class Plants:
    """Simulate policies in plants of other bores and lengths, against the best fixed schedule for each."""

    limit: int = 12
    """Tubes of each of six plants."""
    fidelity: str = "fast"
    """How closely to simulate."""
    output: Path = Path("output/plants")
    """Folder of the tables; episodes that are there already are not run again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Simulate, store, print."""
        from agents.recommendation.plants import run_study

        run_study(self.limit, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (gains.csv, episodes.csv)")


@dataclass(frozen=True)
class Passes:
    """Play schedules in and back, for both of the study's probes: where is it worth to look?"""

    limit: int = 6
    """Tubes of the test list, the first of it, which are balanced; 0: all."""
    fidelity: str = "fast"
    """How closely to simulate: fast (time-lapse on the way in alone), standard or study."""
    output: Path = Path("output/passes")
    """Folder of the tables; episodes that are there already are not played again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Play, store, print."""
        from agents.evaluation.passes import run_study

        run_study(self.limit, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (passes.csv, episodes.csv)")


@dataclass(frozen=True)
class OptimisePasses:
    """Find the best feed and air in and the best feed and air back, by a Gaussian process over simulated inspections.

    No map knows the way back, so every trial is played: five seconds of a core a tube, and more where it is slow.
    """

    trials: int = 40
    """Schedules played."""
    limit: int = 12
    """Training tubes that each is played in, the first of the list, which are balanced."""
    inspects: Literal["in", "back", "best"] = "best"
    """What a metre counts for: the way in, the way back, or the better of both."""
    output: Path | None = None
    """Folder of the schedule, its trials and how it was made; episodes that are there already are not played again.
    Default: output/optimise-passes, with --tube NAME.toml, --probe NAME and --inspects followed by their names."""
    tube: Path | None = None
    """Your own plant (tube.toml): its task, and tubes drawn from what is known of it instead of the lists."""
    probe: str | None = None
    """A design's file, or the name of one that ships; default: table 2's probe, or that of the plant."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Search, simulate on the validation tubes, store, print."""
        from agents.policies.places import plant_at
        from agents.recommendation.both_ways import called, run_search

        plant, name, output = plant_at(self.tube), called(self.probe), self.output or self._usual_output()
        run_search(self.trials, self.limit, self.inspects, output, self.workers, plant, self.probe)
        print(f"written: {output}/ ({name}.csv: a schedule to evaluate, {name}-trials.csv, {name}.json)")

    def _usual_output(self) -> Path:
        """A folder of its own for every task, since episodes of another one are refused."""
        inspects = None if self.inspects == "best" else self.inspects
        parts = (self.tube and self.tube.stem, self.probe and name_of(Path(self.probe)), inspects)
        return Path("-".join(("output/optimise-passes", *(part for part in parts if part))))


@dataclass(frozen=True)
class Turning:
    """Draw the probe back with feed devices that turn round faster and slower: how gently has it to be done?"""

    limit: int = 6
    """Tubes of the test list, the first of it, which are balanced; 0: all."""
    output: Path = Path("output/turning")
    """Folder of the tables; episodes that are there already are not played again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Play, store, print."""
        from agents.evaluation.turning import run_study

        run_study(self.limit, self.output, self.workers)
        print(f"written: {self.output}/ (turning.csv, episodes.csv)")


@dataclass(frozen=True)
class FeedChanges:
    """Change the feed of a probe that is drawn back, by friction, length and helix: what arrives at the sensor?"""

    output: Path = Path("output/feed-changes")
    """Folder of the table."""

    def run(self) -> None:
        """Simulate, store, print."""
        from agents.evaluation.feed_changes import run_changes

        run_changes(self.output)
        print(f"written: {self.output}/ (changes.csv)")
