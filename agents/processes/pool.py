"""Starts a worker process that is connected by a pipe."""

from __future__ import annotations

import os
import subprocess
import sys
from multiprocessing.connection import Connection, Pipe
from typing import Final

GRACE: Final = 2.0
"""Seconds that a worker may take to end."""


def started(place: str) -> tuple[subprocess.Popen[bytes], Connection]:
    """A process that calls a function with the file descriptor of a pipe, and the other end of the pipe.

    The process has a session of its own, so that Ctrl-C reaches this process alone.

    Args:
        place: of the function, "module:function".
    """
    ours, theirs = Pipe()
    module, _, function = place.partition(":")
    code = f"import sys; sys.path[:] = {sys.path!r}; from {module} import {function}; {function}({theirs.fileno()})"
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-c", code], pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL,
            env=dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1") | os.environ,
            start_new_session=True,
        )  # fmt: skip
    return process, ours
