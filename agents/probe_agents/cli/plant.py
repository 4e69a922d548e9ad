"""Commands log, calibrate, recommend, plc and app."""

from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated

import tyro

from probe_agents.cli.parsing import File, hide_default
from probe_agents.evaluation.workers import Workers
from probe_agents.records.cells import ReadOptions
from probe_agents.terminal.tables import print_line


@dataclass(frozen=True)
class ReadLog:
    """Read the log of a rig (text or Excel) and write a clean file that other commands accept as a schedule.

    Example: probe-env log rig.csv --columns 'Vorschub [mm/s]=feed_speed' --plot output/rig.png
    """

    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="LOG")]]
    """Log file, or the name of a shipped log: example-rig."""
    reading: tyro.conf.OmitArgPrefixes[ReadOptions] = field(default_factory=ReadOptions)
    output: File = None
    """Clean file (.csv), or - to print it and nothing else; default: output/NAME-clean.csv."""
    tube: File = None
    """Your plant (tube.toml) with [instrument]: prints whether the feed is allowed, and writes the metres to repeat
    (NAME-to-repeat.csv) and a schedule of them (repeat-NAME.csv) next to the clean file."""
    plot: File = None
    """Figure of all channels over time and length (.png, .pdf or .svg)."""
    start_length: float = 5.0
    """Inserted length at the start, for a log without an encoder [m]."""
    every: float = 1.0
    """Maximum time between rows of the clean file [s]."""
    tolerance: float = 1e-3
    """Maximum error of the inserted length between rows of the clean file [m]."""
    gap: float = 5.0
    """Maximum gap that is interpolated [s]."""
    backward: float = 0.02
    """Maximum backward motion of the encoder that is treated as noise [m]."""

    def run(self) -> None:
        """Read, write, print."""
        from probe_agents.plant.cleaning import Bounds
        from probe_agents.plant.logs import check_picture, draw_log, print_log, read_log, write_repeat
        from probe_agents.policies.cases import read_case
        from probe_agents.records.atomic import STANDARD_OUTPUT, write_text
        from probe_agents.records.shipped import file_or_shipped
        from probe_agents.terminal.names import name_of

        path = file_or_shipped("logs", self.file)
        output = self.output or Path("output") / f"{name_of(path)}-clean.csv"
        bounds = Bounds(self.gap, self.backward, self.start_length, self.tolerance, self.every)
        if output.suffix != ".csv" and output not in STANDARD_OUTPUT:
            raise ValueError(f"output = {str(output)!r} is not a CSV file (.csv)")
        if self.plot:
            check_picture(self.plot)
        for target in (output, self.plot):
            if target and (target.resolve() == path.resolve() or (target.exists() and target.samefile(path))):
                raise ValueError(f"{str(target)!r} is the log itself; choose another file")
        case = None if self.tube is None else read_case(self.tube, "test")
        if case and case.config.instrument is None:
            raise ValueError(
                f"{self.tube}: instrument: missing, so the log cannot be judged: add the table [instrument]"
            )
        if case and output in STANDARD_OUTPUT:
            raise ValueError("tube: the metres to repeat are files next to --output, which is - here")
        log = read_log(path, self.reading, bounds)
        write_text(output, log.to_csv())
        written = [output, *([draw_log(log, self.plot)] if self.plot else [])]
        if output not in STANDARD_OUTPUT:
            print_log(log, path)
            written += write_repeat(log, name_of(path), case, output.parent) if case else []
            print_line(f"written: {', '.join(map(str, written))}")


@dataclass(frozen=True)
class Calibrate:
    """Estimate friction, contact stiffness, drag and damping from logs, with intervals and a goodness-of-fit test.

    Example: probe-env calibrate rig.csv --tube mine.toml --output output/calibration
    """

    logs: tyro.conf.Positional[Annotated[tuple[Path, ...], hide_default("LOG ...")]]
    """Logs of insertions (see `probe-env log`), or the name of a shipped log: example-rig.
    Each needs root tension, radial or axial acceleration, or eddy-current noise."""
    tube: File = None
    """Your plant (tube.toml), which gives the prior; default: the study's plant."""
    output: Path = Path("output/calibration")
    """Folder of calibration.json, corner.png and bands.png."""
    write_tube: File = None
    """Also write a tube file that uses the calibration: with the tables of --tube, else with instrument and bundle of
    the shipped example."""
    helix_diameters: Annotated[tuple[float, ...], hide_default("FLOAT ...")] = ()
    """Helix diameter of the tube of each log [m], or one for all; needed if the tube file lists several."""
    tubes: Annotated[tuple[str, ...], hide_default("NAME ...")] = ()
    """Name of the tube of each log; logs of one tube share a friction. Default: one tube for each helix diameter."""
    check: File = None
    """Another log of the tube of the first one, which is not fitted: its measurements are compared with those that the
    calibration predicts (check.png)."""
    reading: tyro.conf.OmitArgPrefixes[ReadOptions] = field(default_factory=ReadOptions)

    def run(self) -> None:
        """Read, sample, store, print."""
        for needed in ("emcee", "corner"):  # fails before the sampling of half a minute
            import_module(needed)

        from probe_agents.plant import calibration
        from probe_agents.plant.response import stored_response
        from probe_agents.policies.cases import plant_at
        from probe_agents.records.atomic import write_text
        from probe_agents.records.manifest import origin, write_json
        from probe_env import Plant

        plant, target = plant_at(self.tube) or Plant(), self.output / "calibration.json"
        tube_text = calibration.tube_file(self.write_tube, target, self.tube) if self.write_tube else ""
        cases = calibration.read_cases(self.logs, plant, self.helix_diameters, self.tubes, self.reading)
        other = None
        if self.check:
            tube = [cases[0].scene.tube.helix_diameter], [cases[0].tube]
            (other,) = calibration.read_cases([self.check], plant, *tube, self.reading)
        result = calibration.calibrate(cases, plant, stored_response(), str(self.tube or "tube"))
        corner = calibration.draw_corner(result, self.output / "corner.png")
        pictures = [corner, calibration.draw_bands(result, self.output / "bands.png")]
        calibration.print_calibration(result, with_file=self.tube is not None)
        checks = {}
        if other:
            checked = calibration.check_log(result, other)
            checks["check"] = calibration.print_check(checked)
            pictures.append(calibration.draw_bands(checked, self.output / "check.png"))
        write_json(target, result.to_json() | checks | {"provenance": origin()})
        print_line(f"written: {', '.join(map(str, (target, *pictures)))}")
        if result.misfits:
            print("do not use this posterior: recommend refuses a tube.toml that names it")
        elif self.write_tube:
            write_text(self.write_tube, tube_text)
            print_line(f"written: {self.write_tube}; use it: --tube {self.write_tube}")
        else:
            print_line(f'use it: posterior = "{target}" above the tables of your tube.toml, or --write-tube mine.toml')


@dataclass(frozen=True)
class Recommend:
    """Recommend the schedule with the least hours, or best reward, for your plant, and simulate it with others.

    With --find it is the fastest schedule that still finds flaws of a given depth.

    Example: probe-env recommend my-schedule.csv --tube mine.toml --output output/mine.csv
    """

    schedules: tyro.conf.Positional[Annotated[tuple[str, ...], hide_default("[SCHEDULE ...]")]] = ()
    """Schedules (.csv) to compare with; best-schedule and tension-scheduled are always compared."""
    tube: File = None
    """Your plant (tube.toml), with the posterior of a calibration if there is one; default: the study's plant."""
    find: Annotated[str | None, hide_default("a90=PERCENT")] = None
    """Fastest schedule whose a90 is at most PERCENT of the wall in 95 % of the tubes, such as a90=20. The time against
    a90 is written to NAME-a90.csv."""
    output: Path = Path("output/recommended.csv")
    """Schedule file; a description is written next to it (.json)."""
    policy: File = None
    """Also write a feedback law (.json) over helix diameter, friction (from the root tension) and inserted length."""
    folder: File = None
    """Folder of the simulated episodes and the report; default: NAME-confirmed next to the output."""
    limit: int = 12
    """Number of simulated tubes; 0: all."""
    simulated: bool = True
    """Simulate the schedules."""
    fidelity: str = "fast"
    """Accuracy of the simulation: fast, standard (four times as slow), reference, study, surrogate or auto."""
    anyway: bool = False
    """Accept a calibration that is misspecified."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Search, store, simulate, print."""
        from probe_agents.plant.recommendation import Confirmation, is_misspecified, recommend
        from probe_agents.plant.response import stored_response
        from probe_agents.plant.target import a90_target, recommend_for_target
        from probe_agents.policies.cases import plant_at
        from probe_agents.terminal.names import name_of

        target = None if self.find is None else a90_target(self.find)
        if target is not None and self.policy:
            raise ValueError(
                f"policy = {str(self.policy)!r}: there is no law for a target: leave out --find or --policy"
            )
        if target is not None and not self.simulated:
            raise ValueError("find needs the simulation: remove --no-simulated")
        if self.output.suffix != ".csv":
            raise ValueError(f"output = {str(self.output)!r} is not a CSV file (.csv)")
        if self.policy and self.policy.suffix != ".json":
            raise ValueError(f"policy = {str(self.policy)!r} is not a JSON file (.json)")
        folder = self.folder or self.output.with_name(f"{self.output.stem}-confirmed")
        if self.schedules and not self.simulated:
            raise ValueError("schedules need the simulation: remove --no-simulated")
        name = name_of(self.tube) if self.tube else None
        settings = folder, self.schedules, self.limit, self.fidelity, name
        confirmation = Confirmation(*settings) if self.simulated else None
        plant = plant_at(self.tube)
        if is_misspecified(plant) and not self.anyway:
            raise ValueError(
                f"{self.tube}: posterior: the calibration is misspecified, its logs do not fit the model: calibrate"
                " again, leave it out, or give --anyway"
            )
        if target is not None:
            assert confirmation
            recommend_for_target(target, self.tube, self.output, confirmation, self.workers)
        else:
            recommend(plant, self.output, confirmation, stored_response(), self.policy, self.workers)


@dataclass(frozen=True)
class Plc:
    """Write the recommended schedule and a feedback law for your plant, for a PLC.

    Example: probe-env plc --st output/law.st --csv output/law.csv --tube mine.toml
    """

    st: File = None
    """File of recipe, law (IEC 61131-3 structured text) and scaling of the noise, or - to print it and nothing else."""
    csv: File = None
    """File of the law as a table over helix diameter, friction and length, or - to print it and nothing else."""
    integral: bool = False
    """Add integral action on the noise, as in the policy plc-integral; needs --st."""
    tube: File = None
    """Your plant (tube.toml); its bore, air, probe and ranges enter the law."""

    def run(self) -> None:
        """Write, print."""
        from probe_agents.plant.plc_export import print_law, print_recipe, recipe_of, write_law
        from probe_agents.policies.cases import plant_at, read_case
        from probe_agents.policies.plc_law import STORED, STORED_INTEGRAL, PlantData, read_constants
        from probe_agents.records.atomic import STANDARD_OUTPUT

        if self.integral and not self.st:
            raise ValueError("integral = True needs --st: a table has no memory for the integral action")
        constants = read_constants(STORED_INTEGRAL if self.integral else STORED)
        case = read_case(self.tube, "test")
        written = [file for file in (self.st, self.csv) if file]
        printed = STANDARD_OUTPUT.isdisjoint(written)
        recipe = recipe_of(plant_at(self.tube)) if self.st or printed else ""
        write_law(constants, PlantData.of(case.config), case, self.st, self.csv, self.integral, recipe)
        if printed:
            for file in written:
                print_line(f"written: {file}")
            print_recipe(recipe)
            print_law(constants, self.integral)


@dataclass(frozen=True)
class App:
    """Open the app in the browser: edit a schedule, run it in your tube, watch and compare.

    The page is served to this machine only, to browsers in which the printed address was opened.

    Example: probe-env app --tube mine.toml
    """

    tube: File = None
    """Tube file (tube.toml) to open; default: the study's tubes."""
    port: int = 5006
    """Port of the server; 0: any free port."""
    origin: str | None = None
    """Another address at which a browser opens the page, such as localhost:8080: the other end of an SSH tunnel."""
    output: Path = Path("output/app")
    """Folder of runs, schedules and tubes."""
    show: bool = True
    """Open the page in the default browser."""

    def run(self) -> None:
        """Serve until it is interrupted."""
        from probe_agents.app.server import serve

        serve(self.tube, self.port, self.output, self.show, self.origin)
