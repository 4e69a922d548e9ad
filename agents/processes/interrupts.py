"""Signals: Ctrl-C, SIGTERM and SIGHUP end a command alike, in one line that says what is stored.

The first signal unwinds the stack as ``KeyboardInterrupt``. Where that cannot be done (in an import, which would take
it for a broken package; in a callback or finaliser, which would swallow it), or takes longer than ``GRACE``, and at the
second signal, the process ends where it stands: what is stored is whole at any moment, and workers end with it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from types import FrameType
from typing import Any, NoReturn

from agents.terminal import work

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
TIMED = hasattr(signal, "setitimer")
"""Not on Windows, where unwinding takes the time that it takes."""
GRACE = 3.0
"""Seconds that unwinding may take."""
TELLING = 1.0
"""Seconds that counting what is stored may take where the process cannot be unwound."""


class Interrupt(KeyboardInterrupt):
    """A signal.

    Attributes:
        status: what the command is to exit with.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.status = 128 + number


_heard: list[int] = []
_reported: list[str] = []


@contextmanager
def heard(own: bool) -> Iterator[None]:
    """Hear signals while it is entered.

    Args:
        own: the process is the command's own: a signal that comes after it ends the process without a word. Otherwise
            the handlers from before are put back.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread can set handlers
        return
    _heard.clear()
    _reported.clear()
    work.forget()
    before = {number: signal.getsignal(number) for number in (*SIGNALS, *([signal.SIGALRM] if TIMED else []))}
    hook = sys.unraisablehook
    sys.unraisablehook = partial(_unraisable, hook)
    for number in SIGNALS:
        if before[number] is not signal.SIG_IGN:  # nohup, or a job in the background of a script
            signal.signal(number, _hear)
    try:
        yield
    finally:
        if TIMED:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if own and handler is not signal.SIG_IGN else handler)


def tell(error: KeyboardInterrupt) -> int:
    """Say what is stored, once, on stderr; returns the exit status."""
    if not _reported:
        _reported.append(work.account())
        with suppress(OSError):  # the terminal may be gone
            print(f"probe-env: interrupted: {_reported[0]}", file=sys.stderr, flush=True)
    return getattr(error, "status", 128 + signal.SIGINT)


def _hear(number: int, frame: FrameType | None) -> None:
    if _heard or _importing(frame):
        _leave(number)
    _heard.append(number)
    _after(GRACE, lambda *_: _leave(number))
    raise Interrupt(number)


def _after(seconds: float, handler: Callable[..., Any]) -> None:
    if TIMED:
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _unraisable(before: Callable[[Any], object], problem: Any) -> None:
    """An interrupt that was swallowed where nothing can be raised; what else comes is for the hook from before."""
    if problem.exc_type is not None and issubclass(problem.exc_type, KeyboardInterrupt):
        _leave(_heard[0] if _heard else signal.SIGINT)
    before(problem)


def _leave(number: int) -> NoReturn:
    """End here and now, with the line if it has not been said."""
    _after(TELLING, lambda *_: os._exit(128 + number))  # counting may need a lock that is held
    with suppress(BaseException):
        if not _reported and sys.stderr.isatty():
            print(file=sys.stderr)  # below a progress bar
        tell(Interrupt(number))
    os._exit(128 + number)
