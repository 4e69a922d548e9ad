"""State of the app: what all pages share, and one browser session (tube, schedule, runs)."""

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from probe_agents.app.forms import TubeForm, check_target
from probe_agents.app.run_store import new_folder
from probe_agents.app.runs import MANUAL, Command, Run, RunQueue, RunRequest
from probe_agents.app.schedules import Points, csv_text, points_of, schedule_of
from probe_agents.policies.cases import EvaluationCase, load_case, map_of
from probe_agents.records.atomic import write_atomically
from probe_agents.records.shipped import policy_file
from probe_agents.terminal.names import checked_name, name_of
from probe_env.envs.vibration_map import stored_map
from probe_env.schedule import Interpolation, Schedule
from probe_env.settings import errors_in


@dataclass(frozen=True)
class AppState:
    """Shared by all pages: the queue of runs, the folder of runs, schedules and tubes, and the reports to serve."""

    queue: RunQueue
    output: Path
    reports: set[Path] = field(default_factory=set)  # evaluation folders that a page has shown


@dataclass
class Session:
    """One page."""

    app: AppState  # shared state
    tube: TubeForm = field(default_factory=TubeForm)  # tube and probe
    name: str = "my-schedule"  # schedule
    points: Points = field(default_factory=lambda: points_of(Schedule.read(policy_file("example"))))  # schedule
    interpolation: Interpolation = "linear"  # schedule
    run: Run | None = None  # run to show; None: none yet

    def case(self, limit: int = 6) -> EvaluationCase:
        """Evaluation case of the present tube."""
        if self.tube.is_study:
            return load_case(None, "test", limit)
        vibration = stored_map() if self.tube.changed else map_of(self.tube.path, self.tube.plant)
        return load_case(self.tube.plant, "test", limit, vibration=vibration)

    def open_schedule(self, path: Path, schedule: Schedule) -> None:
        """Take the points of the schedule of a file."""
        with errors_in(path):
            self.points, self.interpolation = points_of(schedule), schedule.interpolation
        self.name = name_of(path)

    def store_upload(self, filename: str, content: str) -> Path:
        """Store a file that the browser has sent, in base64; other contents of the same name are another file."""
        if not content:
            raise ValueError(f"{filename}: empty, or more than the 14 MB that a page sends: type its path instead")
        folder = self.app.output / "uploads" / hashlib.sha256(content.encode()).hexdigest()[:16]
        path = folder / checked_name(PurePath(filename).name, "file")
        write_atomically(path, base64.b64decode(content))
        return path

    def save_tube(self, name: str, replace: bool) -> Path:
        """Write the tube file, see ``TubeForm.save``; the app's folder for them is ``tubes/``."""
        self.tube.save(Path(name), self.app.output / "tubes", replace)
        return self.tube.path or Path(name)

    def save_schedule(self, name: str, replace: bool) -> Path:
        """Write the schedule to ``schedules/`` in the app's folder; raises as ``check_target``."""
        self.name = checked_name(name.removesuffix(".csv"), "schedule")
        return self._write_schedule(self.app.output / "schedules", replace)

    def start(
        self, policies: Sequence[str], commands: Sequence[Command], with_schedule: bool = False, **options: Any
    ) -> Run:
        """Add a run of policies, of the session's schedule, or of a manual drive.

        Args:
            policies: policy specs.
            commands: commands for the start of the run.
            with_schedule: whether to include the session's schedule.
            options: other fields of the request.
        """
        if with_schedule:
            schedule_of(self.points, self.interpolation)
        elif not policies:
            raise ValueError("policies = none: at least one is needed")
        tube = self.tube.file_for_run(self.app.output / "tubes")
        name = MANUAL if options.get("manual") else self.name if with_schedule else policies[0]
        folder = new_folder(self.app.output, name)
        specs = [spec for spec in policies if not (with_schedule and spec == self.name)]
        if with_schedule:
            specs.insert(0, f"{self.name}={self._write_schedule(folder)}")
        self.run = self.app.queue.add(RunRequest(policies=tuple(specs), output=folder, tube=tube, **options), commands)
        return self.run

    def _write_schedule(self, folder: Path, replace: bool = False) -> Path:
        schedule_of(self.points, self.interpolation)
        path = folder / f"{self.name.replace('/', '-')}.csv"
        check_target(path, Schedule.read, replace)
        write_atomically(path, csv_text(self.points, self.interpolation))
        return path
