"""Stops and kills work at a defined point: at the n-th call of a function, or when a file is stored."""

import importlib
import itertools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

# A server that imports once and forks for each piece of work: it has no threads, which a fork would cut off
SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["probe_agents.training.train", "probe_agents.design.search"])


class Killed(BaseException):
    """In the process of the tests, in the place of a kill."""


def stop():
    """End the work as a kill would, but for the process."""
    raise Killed


def kill():
    """End this process without a word."""
    os.kill(os.getpid(), signal.SIGKILL)


def killed_at(point: str, number: int, work: Callable[..., Any], *arguments: Any, after: bool = False) -> bool:
    """Whether the work was killed, by SIGKILL, before it came to its end.

    Args:
        point: dotted name of the function at whose call the process kills itself; it is looked up at the call.
        number: of that call, from 1 on.
        work: function of a module, run in a process of its own.
        arguments: of it.
        after: kill when the call is over, not before it.
    """
    process = SERVER.Process(target=_run, args=(point, number, after, work, arguments))
    process.start()
    process.join()
    assert process.exitcode in (0, -signal.SIGKILL), f"exit code {process.exitcode}"
    return process.exitcode != 0


def _run(point: str, number: int, after: bool, work: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    tqdm.set_lock(threading.RLock())  # its own, between processes, would be left behind
    module, name = point.rsplit(".", 1)
    owner: Any
    try:
        owner = importlib.import_module(module)
    except ModuleNotFoundError:  # a method
        owner = getattr(importlib.import_module(module.rsplit(".", 1)[0]), module.rsplit(".", 1)[1])
    function, calls = getattr(owner, name), itertools.count(1)

    def counted(*given: Any, **named: Any) -> Any:
        here = next(calls) == number
        if here and not after:
            kill()
        result = function(*given, **named)
        if here:
            kill()
        return result

    setattr(owner, name, counted)
    work(*arguments)


def hook_sync(name, count, action, patch=None):
    """Call ``action`` after the ``count``-th line of a file of this name is on the disk; ``patch``: a monkeypatch."""
    original, calls = os.fsync, itertools.count(1)

    def fsync(descriptor):
        original(descriptor)
        if Path(os.readlink(f"/proc/self/fd/{descriptor}")).name == name and next(calls) == count:
            action()

    patch.setattr(os, "fsync", fsync) if patch else setattr(os, "fsync", fsync)


def hook_replace(name, count, action, patch=None):
    """Call ``action`` when a file of this name is about to be put in its place for the ``count``-th time."""
    original, calls = os.replace, itertools.count(1)

    def replace(source, target):
        if Path(target).name == name and next(calls) == count:
            action()
        original(source, target)

    patch.setattr(os, "replace", replace) if patch else setattr(os, "replace", replace)


def stat_of(pid):
    """State, parent and so on of a process; nothing if there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def alive(pid):
    """Whether a process runs; one that waits for its parent to look at its end does not."""
    return stat_of(pid)[:1] not in ([], ["Z"])
