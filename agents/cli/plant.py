"""Commands log, calibrate, recommend and plc."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.evaluation.workers import Workers


@dataclass(frozen=True)
class ReadLog:
    """Read a rig's log (text or Excel), show it, and write a clean file that all commands take as a schedule."""

    file: tyro.conf.Positional[Path]
    """The log, or the name of one that ships: example-rig."""
    columns: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="HEAD=QUANTITY[UNIT]")]] = ()
    """What columns are whose heads are not known: "Vorschub [mm/s]=feed_speed", "v=feed_speed[mm/s]". Quantities: time,
    inserted_length, feed_speed, air_supply, root_tension, radial_acceleration_rms, axial_acceleration_rms,
    rf_noise_rms; or date, of a clock in another column. May be given several times."""
    output: Path | None = None
    """The clean file (.csv); default: output/NAME-clean.csv. Never the log itself."""
    plot: Path | None = None
    """Picture of all channels over time and length (.png, .pdf or .svg)."""
    sheet: str | None = None
    """Sheet of an Excel workbook; default: the first."""
    decimal: Literal["auto", "point", "comma"] = "auto"
    """Decimal sign, where the file leaves it open."""
    air_supply: float | None = None
    """Air supply of a log without that column [m3/h]."""
    start_length: float = 5.0
    """Inserted length at the beginning of a log without an encoder [m]."""
    every: float = 1.0
    """Rows of the clean file are no further apart [s]."""
    tolerance: float = 1e-3
    """How far the inserted length may be off after thinning [m]."""
    gap: float = 5.0
    """Gaps in time and missing values are bridged up to this [s]."""
    backward: float = 0.02
    """Motion of the encoder backwards that is taken for its noise [m]."""

    def run(self) -> None:
        """Read, write, print."""
        from agents.plant.cleaning import Bounds
        from agents.plant.logs import check_picture, draw_log, print_log, read_log
        from agents.records.atomic import write_atomically
        from agents.records.shipped import file_or_shipped
        from agents.terminal.names import name_of
        from probe_env.files import one_line

        path = file_or_shipped("logs", self.file)
        output = self.output or Path("output") / f"{name_of(path)}-clean.csv"
        bounds = Bounds(self.gap, self.backward, self.start_length, self.tolerance, self.every)
        if output.suffix != ".csv":
            raise ValueError(f"output = {str(output)!r} is not a CSV file (.csv), which schedules are")
        if self.plot:
            check_picture(self.plot)
        for target in (output, self.plot):
            if target and (target.resolve() == path.resolve() or (target.exists() and target.samefile(path))):
                raise ValueError(f"{str(target)!r} is the log itself, which stays as it is: name another file")
        air = None if self.air_supply is None else self.air_supply / 3600.0
        log = read_log(path, self.columns, bounds=bounds, sheet=self.sheet, decimal=self.decimal, air_supply_rate=air)
        write_atomically(output, log.to_csv())
        print_log(log, path)
        written = [output, *([draw_log(log, self.plot)] if self.plot else [])]
        print(one_line(f"written: {', '.join(map(str, written))}"))


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
        from agents.records.manifest import origin, write_json
        from probe_env import Plant

        plant = plant_at(self.tube) or Plant()
        recorded = recorded_of(self.logs, plant, self.helix_diameters, self.tubes, self.columns)
        response = stored_response()
        calibration = calibrate(recorded, plant, response, str(self.tube or "tube"))
        target = self.output / "calibration.json"
        write_json(target, calibration.to_json() | {"provenance": origin()})
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
class Plc:
    """A feedback law of ten constants, as structured text and table for your plant."""

    st: Path | None = None
    """Write the law as IEC 61131-3 structured text here."""
    csv: Path | None = None
    """Write it as a table by helix diameter, friction and length here."""
    trimmed: bool = False
    """With --st: with integral action on the noise, as the policy trimmed-law acts."""
    tube: Path | None = None
    """Your own plant (tube.toml), whose bore, air, probe and ranges the law takes."""

    def run(self) -> None:
        """Write, print."""
        from agents.plant.plc_export import print_law, write_law
        from agents.policies.places import place_at
        from agents.policies.plc_law import PlantData, read_constants, read_trim

        if self.trimmed and not self.st:
            raise ValueError("trimmed = True needs --st: a table has no memory to trim with")
        constants = read_constants()
        place = place_at(self.tube, "test")
        trim = read_trim() if self.trimmed else None
        write_law(constants, PlantData.of(place.config), place, self.st, self.csv, trim)
        print_law(constants, trim)
