"""Work that is killed at a defined point, and not at a lucky moment: the n-th call of a function, or on a file."""

import importlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

# A server that imports once and forks for each piece of work: it has no threads, which a fork would cut off
SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(
    ["agents.evaluation.run", "agents.learning.tuning", "agents.design.compare", "agents.design.search"]
)


def killed_at(
    point: str, number: int, work: Callable[..., Any], *arguments: Any, after: bool = False, within: str = ""
) -> bool:
    """Whether the work was killed, by SIGKILL, before it came to its end.

    Args:
        point: dotted name of the function at whose call the process kills itself; it is looked up at the call.
        number: of that call, from 1 on.
        work: function of a module, run in a process of its own.
        arguments: of it.
        after: kill when the call is over, not before it.
        within: count only calls with this text in one of their arguments, as the path of a file.
    """
    process = SERVER.Process(target=_run, args=(point, number, after, within, work, arguments))
    process.start()
    process.join()
    assert process.exitcode in (0, -signal.SIGKILL), f"exit code {process.exitcode}"
    return process.exitcode != 0


def _run(
    point: str, number: int, after: bool, within: str, work: Callable[..., Any], arguments: tuple[Any, ...]
) -> None:
    tqdm.set_lock(threading.RLock())  # its own, between processes, would be left behind
    module, name = point.rsplit(".", 1)
    owner: Any
    try:
        owner = importlib.import_module(module)
    except ModuleNotFoundError:  # a method
        owner = getattr(importlib.import_module(module.rsplit(".", 1)[0]), module.rsplit(".", 1)[1])
    function, calls = getattr(owner, name), 0

    def counted(*given: Any, **named: Any) -> Any:
        nonlocal calls
        calls += any(within in str(value) for value in given)
        reached = calls == number and any(within in str(value) for value in given)
        if reached and not after:
            os.kill(os.getpid(), signal.SIGKILL)
        result = function(*given, **named)
        if reached:
            os.kill(os.getpid(), signal.SIGKILL)
        return result

    setattr(owner, name, counted)
    work(*arguments)


def hook_sync(name, count, action):
    """Call ``action`` after the ``count``-th line of a file of this name is on the disk."""
    original, seen = os.fsync, []

    def fsync(descriptor):
        original(descriptor)
        if Path(os.readlink(f"/proc/self/fd/{descriptor}")).name == name:
            seen.append(name)
            if len(seen) == count:
                action()

    os.fsync = fsync


def hook_replace(name, count, action):
    """Call ``action`` when a file of this name is about to be put in its place for the ``count``-th time."""
    original, seen = os.replace, []

    def replace(source, target):
        if Path(target).name == name:
            seen.append(name)
            if len(seen) == count:
                action()
        original(source, target)

    os.replace = replace


def kill(pids_file=None):
    """End this process without a word; before, write the ids of its workers to a file."""
    if pids_file:
        Path(pids_file).write_text(" ".join(map(str, children())))
    os.kill(os.getpid(), signal.SIGKILL)


def children():
    """Ids of the processes that this one has started."""
    stats = ((int(path.name), stat_of(path.name)) for path in Path("/proc").glob("[0-9]*"))
    return [pid for pid, stat in stats if stat and int(stat[1]) == os.getpid()]


def stat_of(pid):
    """State, parent and so on of a process; nothing if there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def killed(function, *arguments):
    """Run a function that ends by ``kill`` in a process of its own."""
    process = SERVER.Process(target=function, args=arguments)
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL


def all_gone(pids_file):
    """Whether all processes of a file are gone, within a minute at most."""
    pids, patience = [int(pid) for pid in Path(pids_file).read_text().split()], 600
    assert pids
    while patience and any(alive(pid) for pid in pids):
        time.sleep(0.1)
        patience -= 1
    return patience > 0


def alive(pid):
    """Whether a process runs; one that waits for its parent to look at its end does not."""
    return stat_of(pid)[:1] not in ([], ["Z"])
