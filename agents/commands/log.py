"""The command for what inspection rigs write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


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
