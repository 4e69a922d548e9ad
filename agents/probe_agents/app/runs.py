"""Runs of the app: the request, the messages of the worker process, and the queue of runs."""

import os
import shlex
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_agents.evaluation.plan import EpisodeId, Plan
from probe_agents.evaluation.run import plan_of
from probe_agents.policies.cases import read_case
from probe_agents.policies.catalogue import name_and_spec
from probe_agents.policies.fixed import STUDY_AIR, STUDY_FEED
from probe_agents.records.models import Stored
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.pictures.strip import Motion
from probe_env.envs.task.config import TaskConfig
from probe_env.inspection.channels import Flaw, Recording, along_flaw, channels, filtered, smoothed
from probe_env.inspection.detection import snr_at, threshold
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.snr import snr_of_groove

MANUAL: Final = "by hand"
"""Policy name of the manual drive."""
INFO_COLUMNS: Final = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n")
COLUMNS: Final = (*INFO_COLUMNS, "target_feed_speed", "target_air_supply_rate", "reward")
"""Columns of a control period in SI units; the reward is the sum of the episode so far."""
MIN_SAMPLES: Final = 100
"""Least number of samples of the sensor in a chart."""
State = Literal["waiting", "running", "finished", "stopped", "failed"]
ACTIVE: Final = ("waiting", "running")
GRACE: Final = 0.5
"""Time that a worker has to end [s]."""


class ManualPolicy:
    """Policy that applies the feed and air of the user, for one insertion.

    Args:
        config: the task.

    Attributes:
        feed_speed, air_supply_rate: current setting [m/s], [m3/s].
    """

    def __init__(self, config: TaskConfig) -> None:
        self.config = config
        (feed, air), *_ = config.feasible(STUDY_FEED, STUDY_AIR)
        self.feed_speed, self.air_supply_rate = float(feed), float(air)
        self._history: list[tuple[float, float]] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """The action (1, 2) of the current setting, which is recorded; there is no recurrent state."""
        if state is None:
            self._history.clear()
        self._history.append((self.feed_speed, self.air_supply_rate))
        return self.config.actions(self.feed_speed, self.air_supply_rate).astype(np.float32), ()

    def describe(self) -> dict[str, Any]:
        """Description with the schedule over time driven so far."""
        feed, air = zip(*self._history, strict=True) if self._history else ((), ())
        position = [k * self.config.period for k in range(len(feed))]
        setting = {"feed_speed": list(feed), "air_supply_rate": list(air), "start_length": None}
        schedule = {"over": "time", "interpolation": "steps", "position": position, **setting}
        return {"policy": type(self).__name__, "schedule": schedule}


class RunRequest(Stored):
    """One evaluation to run, stored as ``request.json`` in its folder."""

    policies: tuple[str, ...]  # specs as in ``probe_agents.policies.catalogue``
    output: Path  # folder of the evaluation
    tube: Path | None = None  # tube file; None: the shipped tubes
    limit: int = 1  # number of tubes
    fidelity: str = "fast"  # preset of the simulation
    manual: bool = False  # whether the user drives by hand next to the policies

    @property
    def names(self) -> list[str]:
        """Policy names as in the tables."""
        return [MANUAL] * self.manual + [name_and_spec(spec)[0] for spec in self.policies]

    @property
    def command(self) -> str:
        """Equivalent command line; for a manual drive that of the app."""
        if self.manual:
            return "probe-env app"
        tube = [] if self.tube is None else ["--tube", str(self.tube)]
        options = ["--limit", str(self.limit), "--fidelity", self.fidelity]
        return "probe-env evaluate " + shlex.join([*self.policies, *tube, *options, "--output", str(self.output)])

    def plan(self) -> Plan:
        """The evaluation plan."""
        case = read_case(self.tube, "test", self.limit)
        plan = plan_of(self.policies or ("constant",), case, 1, self.fidelity)
        manual = {MANUAL: ManualPolicy(plan.config)} if self.manual else {}
        return replace(plan, policies=manual | (dict(plan.policies) if self.policies else {}))


class Command(NamedTuple):
    """Command to the worker while it simulates.

    Values: of "pace" periods per second, 0 for no limit; of "watch" the index of a probe; of "setting" feed speed [m/s]
    and air supply [m3/s]. "slow motion" requests slow motion of the next period.
    """

    name: Literal["continue", "pause", "step", "stop", "pace", "watch", "slow motion", "setting"]
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class ProbeShape:
    """The watched probe at the end of a period, with its f floats from the entrance inwards."""

    position: FloatArray  # (f,) of the unstretched probe from the entrance [m]
    axial: FloatArray  # (f,) displacement [m]
    radial: FloatArray  # (f,) displacement [m]; radial below 0 presses on the inner wall
    tension: FloatArray  # (f,) axial force in the cable on the side of the entrance [N]
    lever: FloatArray  # (f,) half the diameter of the float [m]
    outer_gap: FloatArray  # (f,) radial displacement at contact with the outer wall [m]; infinite without that wall
    sensor: int  # index of the float nearest to the sensor
    bore: float  # of the tube [m]
    helix_length: float  # of the tube [m]
    signal_time: FloatArray  # (m,) last second of the sensor's motion, before now [s]
    signal_radial: FloatArray  # (m,) displacement in this time [m]
    spectrum: FloatArray  # spectral density of the motion for the filter, at ``inspection.spectrum.FREQUENCY`` [m2/Hz]
    feed_speed: float  # at the end of the period [m/s]
    observation: dict[str, float]  # next observation of the policy, SI units


@dataclass(frozen=True)
class Frame:
    """State of a run, sent several times a second."""

    units: tuple[EpisodeId | None, ...]  # episodes in progress; None: no episode at this index
    watched: int  # index of the episode in ``shape``
    unit: EpisodeId | None  # episode in ``shape``, which may have ended
    rows: tuple[tuple[EpisodeId, FloatArray], ...]  # (p, columns) periods of each episode since the last frame
    shape: ProbeShape | None  # None: no episode has begun
    done: int  # number of finished episodes
    paused: bool  # whether the worker waits for "continue"


@dataclass(frozen=True)
class RunStarted:
    """Sent when a run begins."""

    planned: int = 0  # number of episodes
    notes: tuple[str, ...] = ()  # warnings about its policies
    limit: float | None = None  # limit of the radial rms [m]; None: the limit of the task is of another measure
    sensor: Sensor = field(default_factory=Sensor)  # sensor model


@dataclass(frozen=True)
class RunEnded:
    """Sent when a run ends; ``problem`` says why it failed."""

    state: State
    problem: str = ""


Message = RunStarted | Frame | Motion | RunEnded


@dataclass
class Run:
    """A run and the reports of its worker."""

    request: RunRequest  # evaluation to run
    state: State = "waiting"  # waiting, running or how it ended
    done: int = 0  # number of finished episodes
    problem: str = ""  # error of the run or the worker
    info: RunStarted = field(default_factory=RunStarted)  # number of episodes, warnings, limit and sensor
    frame: Frame | None = None  # last frame
    motion: Motion | None = None  # last slow motion
    traces: dict[EpisodeId, list[FloatArray]] = field(default_factory=dict)  # (p, columns) parts of every episode
    commands: list[Command] = field(default_factory=list)  # commands for its start

    @property
    def paused(self) -> bool:
        """Whether it is running and waits for "continue"."""
        return self.state == "running" and self.frame is not None and self.frame.paused

    def trace(self, unit: EpisodeId) -> dict[str, FloatArray]:
        """(p,) of each of ``COLUMNS`` for an episode."""
        parts = self.traces.get(unit, [])
        return dict(zip(COLUMNS, np.concatenate(parts).T if parts else np.zeros((len(COLUMNS), 0)), strict=True))

    def update(self, message: Message) -> None:
        """Process a message of the worker."""
        match message:
            case RunStarted():
                self.info, self.traces = message, {}
            case Frame():
                self.frame, self.done = message, message.done
                for unit, rows in message.rows:
                    self.traces.setdefault(unit, []).append(rows)
            case Motion():
                self.motion = message
            case RunEnded():
                self.state, self.problem = message.state, message.problem or self.problem
                self.done = self.info.planned if message.state == "finished" else self.done


class RunQueue:
    """Runs requests one after the other in one worker process.

    Attributes:
        runs: all runs of this process, in order.
        changes: increases with every change.
    """

    def __init__(self) -> None:
        self.runs: list[Run] = []
        self.changes = 0
        self._waiting: deque[Run] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._process, self._pipe = start_worker()
        self._thread = threading.Thread(target=self._serve, name="queue", daemon=True)
        self._thread.start()

    def add(self, request: RunRequest, commands: Sequence[Command] = ()) -> Run:
        """Append a run, with commands for its start."""
        run = Run(request, commands=list(commands))
        with self._changed:
            self.runs.append(run)
            self._waiting.append(run)
            self.changes += 1
            self._changed.notify_all()
        return run

    def send(self, run: Run, command: Command) -> None:
        """Send a command to a run; one that has ended ignores it."""
        with self._changed:
            if run.state == "waiting" and command.name == "stop":
                self._waiting.remove(run)
                run.state = "stopped"
                self.changes += 1
            elif run.state == "waiting":
                run.commands.append(command)
            elif run.state == "running":
                with suppress(OSError):  # the thread that receives notices a dead worker
                    self._pipe.send(command)

    def wait(self, run: Run, timeout: float) -> bool:
        """Wait for the end of a run; returns whether it ends within ``timeout`` [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: run.state not in ACTIVE, timeout)

    def close(self) -> None:
        """End the worker; its run is interrupted."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._end_worker()
        self._thread.join(GRACE)

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                run = self._waiting.popleft()
                run.state = "running"
                self.changes += 1
                with suppress(OSError):  # recv notices a dead worker
                    for message in (run.request, *run.commands):  # while locked: no other command comes first
                        self._pipe.send(message)
            try:
                while run.state == "running":
                    self._update(run, self._pipe.recv())
            except (EOFError, OSError):
                if not self._closed:
                    self._end_worker()
                    died = f"the worker process died (exit status {self._process.wait()})"
                    self._update(run, RunEnded("failed", f"{died}: finished insertions are stored, resume the run"))
                    self._process, self._pipe = start_worker()

    def _update(self, run: Run, message: Message) -> None:
        with self._changed:
            run.update(message)
            self.changes += 1
            self._changed.notify_all()

    def _end_worker(self) -> None:
        self._pipe.close()
        try:
            self._process.wait(GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class FlawSignal(NamedTuple):
    """Signals of the last second with a flaw in it."""

    time: FloatArray  # (k,) before now [s], at most 0
    voltages: FloatArray  # (k, 2) X and Y [V], smoothed as in every chart
    near: BoolArray  # (k,) whether the sensor is within the width of the flaw
    snr: float  # signal-to-noise ratio of the flaw, by the spectrum of the motion
    filtered: float  # highest filtered signal at the flaw, in standard deviations of the noise
    threshold: float  # value of ``filtered`` above which a flaw is detected


def flaw_signal(sensor: Sensor, shape: ProbeShape, before: float, depth: float) -> FlawSignal | None:
    """Signals of a flaw passed ``before`` [s] ago with a depth as a share of the wall; None: too few samples.

    The electronic noise has a fixed seed, so that only the flaw changes when it is moved.
    """
    time, feed = shape.signal_time, abs(shape.feed_speed)
    if len(time) < MIN_SAMPLES or feed == 0.0:
        return None
    speeds = np.full(len(time), feed)
    recording = Recording(time - time[0], feed * time, speeds, shape.signal_radial, shape.spectrum[None], len(time))
    flaw = Flaw(-feed * before, depth)
    voltages = channels(sensor, recording, shape.bore, [flaw], np.zeros(0), np.random.default_rng(0))
    near = np.abs(recording.position - flaw.position) <= 0.5 * sensor.flaw_width
    response = filtered(sensor, recording, along_flaw(sensor, voltages))
    groove = snr_of_groove(sensor, np.array([feed]), recording.spectrum)
    snr = float(snr_at(sensor, groove, np.array([depth]))[0, 0])
    highest = float(response[near].max()) if near.any() else 0.0
    return FlawSignal(time, smoothed(recording, voltages), near, snr, highest, threshold(sensor, shape.helix_length))


def start_worker() -> tuple[subprocess.Popen[bytes], Connection]:
    """Start the worker process; returns it with a pipe. It has another session, so Ctrl-C does not reach it."""
    ours, theirs = Pipe()
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; from probe_agents.app.worker import serve; serve({theirs.fileno()})"
    )
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-c", code], pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL,
            env=dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1") | os.environ,
            start_new_session=True,
        )  # fmt: skip
    return process, ours
