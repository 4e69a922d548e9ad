"""Commands for a plant of one's own: what its logs tell, and which schedule is best for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated

import tyro

from agents.processes.workers import Workers


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
