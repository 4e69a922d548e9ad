"""Processes that are killed at a defined point: before or after their n-th call on a file of some name."""

import multiprocessing
import os
import signal
import time
from pathlib import Path

# children are forked from a process that has imported what they need and done nothing else
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["agents.report", "agents.train", "agents.design_compare", "agents.design_search"])


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
    process = CONTEXT.Process(target=function, args=arguments)
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
