"""Worker process: ``probe-env evaluate`` that can be watched, slowed down, paused and stopped.

It ends when the pipe to the server closes; finished insertions are then stored.
"""

import gc
import os
import signal
import time
import warnings
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Final

import numpy as np

from probe_agents.app.run_store import REQUEST
from probe_agents.app.runs import (
    INFO_COLUMNS,
    MANUAL,
    Command,
    Frame,
    ManualPolicy,
    ProbeShape,
    RunEnded,
    RunRequest,
    RunStarted,
)
from probe_agents.evaluation.folder import episodes_of
from probe_agents.evaluation.plan import BATCH, EpisodeId, Plan, Records, RolloutRunner, run_plan
from probe_agents.evaluation.run import report_settings, write_report
from probe_agents.policies.catalogue import user_policies
from probe_agents.records.manifest import write_json
from probe_agents.terminal.messages import format_error
from probe_env import Plant
from probe_env.envs.episodes import Episodes
from probe_env.envs.pictures.strip import Watch
from probe_env.envs.task.observations import in_si_units
from probe_env.errors import SimulationError
from probe_env.physics.simulation.signals import SAMPLE_PERIOD

FRAMES_PER_SECOND: Final = 10.0
SLOW_MOTION: Final = (0.5, 10.0)
"""Simulated time [s] and length behind the tip [m] of a slow motion."""


class StoppedError(Exception):
    """Raised when the user stops a run."""


def serve(descriptor: int) -> None:
    """Run requests from the pipe until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipe = Connection(descriptor)
    with suppress(EOFError, OSError):
        # load the kernels before the first run
        episodes = Episodes(1, Plant().configured(changes={"settle_time": 0.01}), threads=1, fidelity="fast")
        episodes.reset([0], {0: np.random.default_rng(0)})
        gc.freeze()  # a collection of all loaded modules takes 0.2 s
        while True:
            message = pipe.recv()
            if isinstance(message, RunRequest):  # commands after the end of a run are ignored
                _RequestRunner(pipe, message).run()
    os._exit(0)


def row_of(runner: RolloutRunner, k: int) -> tuple[float, ...]:
    """The last period of probe ``k``, the columns ``runs.COLUMNS``."""
    assert runner.last is not None
    names = (*INFO_COLUMNS, "target_feed_speed", "target_air_supply_rate")
    return (*(float(runner.last.infos[k][name]) for name in names), float(runner.episodes.scorer.totals["reward"][k]))


def shape_of(runner: RolloutRunner, k: int) -> ProbeShape:
    """Probe ``k`` at the end of its last period."""
    episodes, simulated = runner.episodes, runner.episodes.simulated()
    simulator = simulated.simulators[k]
    chain, root, scene = simulator.chain, simulator.root, simulator.scene
    nodes = np.flatnonzero(chain.contact_stiffness[: root + 1] > 0.0)[::-1]
    radial = simulated.meter.last_second(k)
    observation = in_si_units(episodes.config, runner.observed(k))
    return ProbeShape(
        position=(root - nodes) * chain.element_length,
        axial=simulator.state.d[nodes, 0],
        radial=simulator.state.d[nodes, 1],
        tension=simulator.state.tension[np.minimum(nodes, root - 1)],
        lever=chain.lever[nodes],
        outer_gap=chain.outer_gap[nodes],
        sensor=int(np.abs(nodes - simulator.sensor).argmin()),
        bore=scene.tube.inner_diameter,
        helix_length=scene.tube.helix_length,
        signal_time=SAMPLE_PERIOD * (np.arange(len(radial)) + 1 - len(radial)),
        signal_radial=radial,
        spectrum=simulated.meter.filter_spectrum(k),
        feed_speed=simulator.feed_speed,
        observation={name: float(values[0]) for name, values in observation.items()},
    )


class _RequestRunner:
    """Runs one request and executes commands during the run."""

    def __init__(self, pipe: Connection, request: RunRequest) -> None:
        self.pipe, self.request = pipe, request
        self.pace, self.paused, self.watched, self.done = 0.0, False, 0, 0
        self.rows: dict[EpisodeId, list[tuple[float, ...]]] = {}
        self.shown_at = self.due = 0.0
        self.manual: ManualPolicy | None = None

    def run(self) -> None:
        """Simulate the missing episodes and report the end of the run."""
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                plan = self.request.plan()
            request, names, output = self.request, list(plan.policies), self.request.output
            users = [MANUAL] * request.manual + user_policies(request.policies)
            report = report_settings(plan, names[1] if request.manual and len(names) > 1 else None, users)
            journal = episodes_of(output)
            plan.folder(output).check(journal.path.name)
            stored = journal.read()
            write_json(output / REQUEST, request.model_dump(mode="json"))  # to resume the run
            self.done = sum(key in stored for key, *_ in plan.planned())
            limit = plan.config.limit if plan.config.vibration_measure == "displacement" else None
            notes = tuple(str(warning.message) for warning in caught)
            self.pipe.send(RunStarted(len(plan.episode_ids()), notes, limit, plan.config.sensor))
            run_plan(plan, output, progress=False, source=self._source, command=request.command, report=report)
            write_report(output)
            self.pipe.send(RunEnded("finished"))
        except StoppedError:
            self.pipe.send(RunEnded("stopped"))
        except (EOFError, ConnectionError):
            raise
        except (ValueError, OSError, SimulationError, RuntimeError, ImportError) as error:
            self.pipe.send(RunEnded("failed", format_error(error)))

    def _source(self, plan: Plan, missing: deque[EpisodeId]) -> Records:
        """Yield the records of the episodes; executes commands and sends frames in between."""
        self.manual = next((p for p in plan.policies.values() if isinstance(p, ManualPolicy)), None)
        runner = RolloutRunner(plan, missing, BATCH, None)
        self.due = time.monotonic()
        while not runner.over:
            self._receive(runner)
            if not runner.decided:
                runner.next_actions()
            ended = list(runner.advance())
            for k in np.flatnonzero(runner.active).tolist():
                self.rows.setdefault(runner.episode_id(k), []).append(row_of(runner, k))
            self.done += len(ended)
            yield from ended
            if runner.over or time.monotonic() - self.shown_at >= 1.0 / FRAMES_PER_SECOND:
                self._show(runner)

    def _receive(self, runner: RolloutRunner) -> None:
        """Execute commands; wait while paused or to limit the pace."""
        while True:
            self.due = max(self.due, time.monotonic() - 1.0)  # does not catch up after a wait
            left = None if self.paused else max(self.due - time.monotonic(), 0.0) if self.pace else 0.0
            if not self.pipe.poll(left):
                break
            command = self.pipe.recv()
            if isinstance(command, Command) and self._execute(command, runner):
                break
        if self.pace:
            self.due += 1.0 / self.pace

    def _execute(self, command: Command, runner: RolloutRunner) -> bool:
        """Execute a command; returns whether to simulate a period immediately."""
        match command.name:
            case "continue":
                self.paused, self.due = False, time.monotonic()
            case "pause":
                self.paused = True
                self._show(runner)
            case "step":
                self.paused, self.shown_at = True, 0.0
                return True
            case "stop":
                raise StoppedError
            case "pace":
                (self.pace,), self.due = command.values, time.monotonic()
            case "watch":
                self.watched = int(command.values[0])
                self._show(runner)
            case "slow motion":
                self._slow_motion(runner)
            case "setting" if self.manual is not None:
                self.manual.feed_speed, self.manual.air_supply_rate = command.values
        return False

    def _show(self, runner: RolloutRunner) -> None:
        """Send a frame."""
        running = runner.episodes.running
        if self.watched >= len(running) or not running[self.watched]:
            self.watched = int(running.argmax()) if running.any() else min(self.watched, len(running) - 1)
        units = tuple(unit if running[k] else None for k, unit in enumerate(runner.ids))
        rows = tuple((unit, np.array(rows)) for unit, rows in self.rows.items())
        unit = runner.ids[self.watched]
        shape = None if unit is None else shape_of(runner, self.watched)
        self.pipe.send(Frame(units, self.watched, unit, rows, shape, self.done, self.paused))
        self.rows, self.shown_at = {}, time.monotonic()

    def _slow_motion(self, runner: RolloutRunner) -> None:
        """Send slow motion of the watched probe, simulated on a copy, so that the run does not change."""
        if not runner.decided:
            runner.next_actions()
        k, episodes = self.watched, runner.episodes
        if not episodes.running[k]:
            return
        simulator, window, duration, length = episodes.simulated().simulators[k], episodes.window, *SLOW_MOTION
        axial = window.axial[:, k] if window and window.axial is not None else np.zeros(0)
        radial = window.radial[:, k] if window and window.radial is not None else np.zeros(0)
        watch = Watch(simulator, length, axial, radial)
        feed, air = episodes.config.targets(runner.actions, allow_standstill=True)[k] * episodes.direction[k]
        with suppress(SimulationError):  # the motion before divergence is sent
            watch.follow(simulator, float(feed), float(air), duration)
        self.pipe.send(watch.motion())
