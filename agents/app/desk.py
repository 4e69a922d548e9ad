"""What is on somebody's desk: their tube, their schedule and their runs; the queue and the folder are everybody's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from agents.app.forms.points import Points, csv_of, points_of, schedule_of
from agents.app.forms.tubes import TubeForm
from agents.app.runs.frames import Order
from agents.app.runs.queue import Queue, Run
from agents.app.runs.shelf import free_folder
from agents.app.runs.wanted import Wanted
from agents.policies.places import Place, map_of, place_of
from agents.records.provenance import write_atomically
from agents.records.shipped import policy_file
from agents.terminal.names import checked_name, name_of
from probe_env.envs.surrogate.vibration_map import stored_map
from probe_env.files import FileError
from probe_env.schedule import Interpolation, Schedule

MINE: Final = "my-schedule"
"""What the schedule on the desk is called until it has a name of its own."""
FIRST: Final = "example"
"""The schedule that a desk begins with."""
EXPECTED_TUBES: Final = 6
"""In which the map is asked while points are dragged."""


@dataclass(frozen=True)
class Office:
    """What all pages share.

    Attributes:
        queue: runs.
        output: folder in which runs, schedules and tubes are kept.
    """

    queue: Queue
    output: Path

    def new_folder(self, name: str) -> Path:
        """A new folder for a run."""
        self.output.mkdir(parents=True, exist_ok=True)
        while True:
            folder = free_folder(self.output, name)
            try:
                folder.mkdir()
            except FileExistsError:  # another page was faster
                continue
            return folder


@dataclass
class Desk:
    """Of one page.

    Attributes:
        office: what is shared.
        tube: the tube.
        name: of the schedule.
        points: of the schedule.
        interpolation: between them.
        run: that is looked at; None: none yet.
    """

    office: Office
    tube: TubeForm = field(default_factory=TubeForm)
    name: str = MINE
    points: Points = field(default_factory=lambda: points_of(Schedule.read(policy_file(FIRST))))
    interpolation: Interpolation = "linear"
    run: Run | None = None

    def place(self, limit: int = EXPECTED_TUBES) -> Place:
        """Task, tubes and map of the tube as it is now.

        Raises:
            ValueError: the map beside its file is damaged or of another tube.
        """
        if self.tube.is_study:
            return place_of(None, "test", limit)
        known = stored_map() if self.tube.changed else map_of(self.tube.path, self.tube.plant)
        return place_of(self.tube.plant, "test", limit, known)

    def open_schedule(self, path: Path) -> None:
        """Take the points of a schedule file.

        Raises:
            FileNotFoundError: no such file.
            FileError: no schedule, or one over time; nothing has changed then.
        """
        schedule = Schedule.read(path)
        try:
            self.points, self.interpolation = points_of(schedule), schedule.interpolation
        except ValueError as error:
            raise FileError(path, str(error)) from error
        self.name = name_of(path)

    def save_schedule(self, name: str) -> Path:
        """Write the schedule as a file that every command takes.

        Raises:
            ValueError: no name for one, or the points are no schedule.
        """
        self.name = checked_name(name.removesuffix(".csv"), "schedule")
        return self._write(self.office.output / "schedules")

    def start(self, policies: Sequence[str], limit: int, fidelity: str, mine: bool = True) -> Run:
        """Put a run of policies in the line, and of the schedule on the desk with its own name.

        Raises:
            ValueError: the points are no schedule, or there is nothing to run.
        """
        if not mine and not policies:
            raise ValueError("policies = none: at least one is needed")
        if mine:
            schedule_of(self.points, self.interpolation)
        kept = self.tube.kept(self.office.output / "tubes")
        folder = self.office.new_folder(self.name if mine else policies[0])
        own = [f"{self.name}={self._write(folder)}"] if mine else []
        others = [name for name in policies if name != self.name]
        self.run = self.office.queue.add(Wanted((*own, *others), folder, kept, limit, fidelity=fidelity))
        return self.run

    def drive(self, rival: str, fidelity: str, orders: Sequence[Order]) -> Run:
        """Begin an insertion that is driven by hand beside a policy."""
        kept = self.tube.kept(self.office.output / "tubes")
        folder = self.office.new_folder("by-hand")
        self.run = self.office.queue.add(Wanted((rival,), folder, kept, fidelity=fidelity, driven=True), orders)
        return self.run

    def _write(self, folder: Path) -> Path:
        schedule_of(self.points, self.interpolation)
        path = folder / f"{self.name.replace('/', '-')}.csv"
        write_atomically(path, csv_of(self.points, self.interpolation))
        return path
