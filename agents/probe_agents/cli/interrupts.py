"""Signal handlers: Ctrl-C, SIGTERM and SIGHUP end a command with one line about what is stored."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from probe_agents.terminal import work

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Interrupt(KeyboardInterrupt):
    """Raised by a signal.

    Attributes:
        status: exit status of the command.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.status = 128 + number


@contextmanager
def signal_handlers() -> Iterator[None]:
    """Raise ``Interrupt`` at the first signal; at the second, end the process.

    Callbacks can swallow the exception and cleanup can be slow, so the second signal does not wait. Stored files are
    complete at any moment, and workers end with this process.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread can set handlers
        return
    work.reset()
    received: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) == 2:
            report(Interrupt(number))
        if len(received) > 1:
            os._exit(128 + number)
        raise Interrupt(number)

    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if before[number] is not signal.SIG_IGN:  # under nohup, or a background job of a script
            signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def report(error: KeyboardInterrupt) -> int:
    """Print on stderr what is stored; returns the exit status."""
    with suppress(OSError):  # the terminal may be gone
        print(f"probe-env: interrupted: {work.stored_text()}", file=sys.stderr, flush=True)
    return getattr(error, "status", 128 + signal.SIGINT)
