"""The process that plays: ``probe-env evaluate`` that can be watched, slowed, paused and stopped.

It lives as long as the pipe to the page's process: that one killed, it ends with the period, and everything that was
finished is in its folder.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Final

import numpy as np

from agents.app.runs.driven import Driven
from agents.app.runs.frames import Frame, Message, Order, Over, Planned, row_of, shape_of
from agents.app.runs.wanted import Wanted
from agents.evaluation.plan import BATCH, Plan, Playing, Unit, lines_of, run_plan, stored_episodes
from agents.evaluation.run import claim_folder
from agents.terminal.refusals import refusal
from probe_env import Plant
from probe_env.envs.episodes import Episodes
from probe_env.envs.pictures.strip import Motion, Watch
from probe_env.errors import SimulationError

FRAMES_PER_SECOND: Final = 10.0
LOOK: Final = 0.5
"""Of the dynamics in slow motion [s]."""
LOOKED_AT: Final = 10.0
"""Behind the tip in slow motion [m]."""


class _StoppedError(Exception):
    """Somebody has had enough of a run."""


def serve(descriptor: int) -> None:
    """A worker's life: run what comes through the pipe until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipe = Connection(descriptor)
    with suppress(EOFError, OSError):
        _warm()
        gc.freeze()  # what is loaded: to look through it for garbage takes a fifth of a second
        while True:
            order = pipe.recv()
            if isinstance(order, Wanted):  # orders that came after the end of a run are of no use
                _Run(pipe, order).play()
    os._exit(0)


def _warm() -> None:
    """Load the kernels and hash the code that results depend on, so that the first run begins at once."""
    episodes = Episodes(1, Plant().configured(changes={"settle_time": 0.01}), threads=1, fidelity="fast")
    episodes.reset([0], {0: np.random.default_rng(0)})
    Plan({}, (), fidelity=episodes.fidelity).setting()


class _Run:
    """One run, and where it is."""

    def __init__(self, pipe: Connection, wanted: Wanted) -> None:
        self.pipe, self.wanted = pipe, wanted
        self.pace, self.paused, self.watched = 0.0, False, 0
        self.done = self.planned = 0
        self.rows: dict[Unit, list[tuple[float, ...]]] = {}
        self.shown = self.due = 0.0
        self.driven: Driven | None = None

    def play(self) -> None:
        """Play what is missing, and tell how it ended."""
        sys.argv = self.wanted.command.split()[:1] + (["app"] if self.wanted.driven else self._arguments())
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                plan = self.wanted.plan()
            names = list(plan.policies)
            against = names[1] if self.wanted.driven and len(names) > 1 else None
            claim_folder(plan, self.wanted.output, against, self.wanted.own)
            self.planned = len(plan.units())
            self.done = self.planned - len(_missing(plan, self.wanted))
            limit = plan.config.limit if plan.config.vibration_measure == "displacement" else None
            self._send(Planned(self.planned, tuple(str(w.message) for w in caught), limit, plan.config.sensor))
            run_plan(plan, self.wanted.output, progress=False, source=self._source)
            self._send(Over("finished"))
        except _StoppedError:
            self._send(Over("stopped"))
        except (EOFError, BrokenPipeError, ConnectionError):
            raise
        except (ValueError, OSError, SimulationError, RuntimeError, ImportError) as error:
            self._send(Over("failed", refusal(error)))

    def _arguments(self) -> list[str]:
        return ["evaluate", *self.wanted.arguments]

    def _send(self, message: Message) -> None:
        self.pipe.send(message)

    def _source(self, plan: Plan, missing: deque[Unit]) -> Iterator[str]:
        """The episodes' lines, with an ear for orders and frames in between."""
        self.driven = next((p for p in plan.policies.values() if isinstance(p, Driven)), None)
        playing = Playing(plan, missing, BATCH, None)
        self.due = time.monotonic()
        while not playing.over:
            self._hear(playing)
            if not playing.decided:
                playing.decide()
            ended = list(playing.advance())
            for k in np.flatnonzero(playing.active).tolist():
                self.rows.setdefault(playing.unit(k), []).append(row_of(playing, k))
            self.done += len(ended)
            yield from lines_of(plan, ended)
            if playing.over or time.monotonic() - self.shown >= 1.0 / FRAMES_PER_SECOND:
                self._show(playing)

    def _hear(self, playing: Playing) -> None:
        """Obey what was ordered; wait while it is paused, or as long as the pace asks for."""
        while True:
            self.due = max(self.due, time.monotonic() - 1.0)  # no hurry after a wait
            left = None if self.paused else max(self.due - time.monotonic(), 0.0) if self.pace else 0.0
            if not self.pipe.poll(left):
                break
            order = self.pipe.recv()
            if isinstance(order, Order) and self._obey(order, playing):
                break
        if self.pace:
            self.due += 1.0 / self.pace

    def _obey(self, order: Order, playing: Playing) -> bool:
        """Do what was ordered; whether a period is to be played at once."""
        match order.do:
            case "go":
                self.paused, self.due = False, time.monotonic()
            case "pause":
                self.paused = True
                self._show(playing)
            case "step":
                self.paused, self.shown = True, 0.0
                return True
            case "stop":
                raise _StoppedError
            case "pace":
                (self.pace,) = order.values
                self.due = time.monotonic()
            case "watch":
                self.watched = int(order.values[0])
                self._show(playing)
            case "look":
                self._look(playing)
            case "hand" if self.driven is not None:
                self.driven.feed_speed, self.driven.air_supply_rate = order.values
        return False

    def _show(self, playing: Playing) -> None:
        """Send a frame."""
        running = playing.episodes.running
        if self.watched >= len(running) or not running[self.watched]:
            self.watched = int(running.argmax()) if running.any() else min(self.watched, len(running) - 1)
        begun = playing.units[self.watched] is not None
        units = tuple(unit if running[k] else None for k, unit in enumerate(playing.units))
        rows = tuple((unit, np.array(rows)) for unit, rows in self.rows.items())
        shape = shape_of(playing, self.watched) if begun else None
        self._send(Frame(units, self.watched, rows, shape, self.done, self.planned, self.paused))
        self.rows, self.shown = {}, time.monotonic()

    def _look(self, playing: Playing) -> None:
        """Send slow motion of what the watched probe is about to do; it goes on bit for bit as it would have."""
        if not playing.decided:
            playing.decide()
        k, episodes = self.watched, playing.episodes
        if not episodes.running[k]:
            return
        simulator, felt = episodes.batch.simulators[k], episodes.window
        nothing = np.zeros(0)
        axial = felt.axial[:, k] if felt and felt.axial is not None else nothing
        radial = felt.radial[:, k] if felt and felt.radial is not None else nothing
        watch = Watch(simulator, LOOKED_AT, axial, radial)
        feed, air = episodes.config.targets(playing.actions, may_stand=True)[k] * episodes.passes.way[k]
        with suppress(SimulationError):  # what was seen until it diverged is shown
            watch.follow(simulator, float(feed), float(air), LOOK)
        motion: Motion = watch.motion()
        self._send(motion)


def _missing(plan: Plan, wanted: Wanted) -> list[str]:
    done = stored_episodes(plan, wanted.output)
    return [key for key, *_ in plan.planned() if key not in done]
