"""Runs in line: one is played by the worker, the others wait; what each has shown is kept for every page."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from agents.app.runs.frames import COLUMNS, Frame, Message, Order, Over, Planned
from agents.app.runs.wanted import Wanted
from agents.evaluation.plan import Unit
from agents.processes.pool import GRACE, started
from probe_env.arrays import FloatArray
from probe_env.envs.pictures.strip import Motion
from probe_env.inspection.sensor import Sensor

State = Literal["waiting", "running", "finished", "stopped", "failed"]
ATTEMPTS: Final = 3
"""Times in a row that a worker may be lost without an episode having been finished."""


@dataclass
class Run:
    """A run and what is known of it.

    Attributes:
        wanted: what is run.
        state: where it is.
        done, planned: episodes.
        problem: why it failed, or what happened on the way.
        notes: what was said of its policies.
        limit: of the radial rms [m]; None: not known, or of another measure.
        sensor: of its tube.
        frame: the last one.
        film: the last slow motion.
        films: how many there were.
        traces: unit -> (p, columns) all its periods.
        orders: given before it began.
    """

    wanted: Wanted
    state: State = "waiting"
    done: int = 0
    planned: int = 0
    problem: str = ""
    notes: tuple[str, ...] = ()
    limit: float | None = None
    sensor: Sensor = field(default_factory=Sensor)
    frame: Frame | None = None
    film: Motion | None = None
    films: int = 0
    traces: dict[Unit, list[FloatArray]] = field(default_factory=dict)
    orders: list[Order] = field(default_factory=list)

    def trace(self, unit: Unit) -> FloatArray:
        """(p, columns) of a unit, see ``frames.COLUMNS``."""
        parts = self.traces.get(unit, [])
        return np.concatenate(parts) if parts else np.zeros((0, len(COLUMNS)))

    def note(self, message: Message) -> None:
        """Take in what the worker tells."""
        match message:
            case Planned():
                self.planned, self.notes = message.episodes, message.notes
                self.limit, self.sensor, self.traces = message.limit, message.sensor, {}
            case Frame():
                self.frame, self.done, self.planned = message, message.done, message.planned
                for unit, rows in message.rows:
                    self.traces.setdefault(unit, []).append(rows)
            case Motion():
                self.film, self.films = message, self.films + 1
            case Over():
                self.state, self.problem = message.state, message.problem or self.problem
                self.done = self.planned if message.state == "finished" else self.done


class Queue:
    """Plays one run after the other in a worker process, which stays for the next.

    Attributes:
        runs: all of this process, in the order in which they were wanted.
        changes: grows with everything that happens, for who looks now and then.
    """

    def __init__(self) -> None:
        self.runs: list[Run] = []
        self.changes = 0
        self._waiting: deque[Run] = deque()
        self._something = threading.Condition()
        self._closed = False
        self._process, self._pipe = started("agents.app.runs.worker:serve")
        self._thread = threading.Thread(target=self._serve, name="queue", daemon=True)
        self._thread.start()

    @property
    def current(self) -> Run | None:
        """The run that is being played."""
        return next((run for run in self.runs if run.state == "running"), None)

    def add(self, wanted: Wanted, orders: Sequence[Order] = ()) -> Run:
        """Put a run at the end of the line, with what it is to be told as it begins."""
        run = Run(wanted, orders=list(orders))
        with self._something:
            self.runs.append(run)
            self._waiting.append(run)
            self.changes += 1
            self._something.notify_all()
        return run

    def order(self, run: Run, order: Order) -> None:
        """Tell a run something; one that waits may be stopped, to the others nothing can be told."""
        with self._something:
            if run.state == "waiting" and order.do == "stop":
                self._waiting.remove(run)
                run.state = "stopped"
                self.changes += 1
            elif run.state == "waiting":
                run.orders.append(order)
            elif run.state == "running":
                with suppress(OSError):  # a worker that is lost is found to be where it is waited for
                    self._pipe.send(order)

    def wait(self, run: Run, timeout: float) -> bool:
        """Whether a run ends within a time [s]."""
        with self._something:
            return self._something.wait_for(lambda: run.state not in ("waiting", "running"), timeout)

    def close(self) -> None:
        """End the worker; the run that it plays is interrupted."""
        with self._something:
            self._closed = True
            self._something.notify_all()
        self._end_worker()
        self._thread.join(GRACE)

    def _serve(self) -> None:
        while True:
            with self._something:
                self._something.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                run = self._waiting.popleft()
                run.state = "running"
                self.changes += 1
            self._play(run)

    def _play(self, run: Run) -> None:
        """Have a run played to its end; one whose worker was lost goes on with what is stored of it."""
        attempts = 0
        while run.state == "running" and not self._closed:
            before = run.done
            try:
                for message in (run.wanted, *run.orders):
                    self._pipe.send(message)
                while run.state == "running":
                    self._note(run, self._pipe.recv())
            except (EOFError, OSError):
                if self._closed:
                    return
                attempts = 1 if run.done > before else attempts + 1
                self._replace_worker(run, attempts)

    def _note(self, run: Run, message: Message) -> None:
        with self._something:
            run.note(message)
            self.changes += 1
            self._something.notify_all()

    def _replace_worker(self, run: Run, attempts: int) -> None:
        self._end_worker()
        status = self._process.wait()
        lost = f"the worker was lost (exit status {status})"
        if attempts >= ATTEMPTS:
            self._note(run, Over("failed", f"{lost} {attempts} times in a row without finishing anything"))
        else:
            run.problem = f"{lost}; what was finished is stored, the rest was begun again"
        self._process, self._pipe = started("agents.app.runs.worker:serve")

    def _end_worker(self) -> None:
        self._pipe.close()
        deadline = time.monotonic() + GRACE
        while self._process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
