"""Work that is killed at a point of its own choice: the n-th call of a function, and not at a lucky moment."""

import importlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from typing import Any

from tqdm import tqdm

# A server that imports once and forks for each piece of work: it has no threads, which a fork would cut off
SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["agents.design_search", "agents.evaluate"])


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
