"""Processes of this machine that work for this one, and send back what they find as they find it.

A worker lives as long as the pipe from the process that started it: it ends within moments however that one ends.
Workers have a session of their own, so that Ctrl-C is heard by the command alone.
"""

from __future__ import annotations

import atexit
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any, Final, Literal

import cloudpickle

from probe_env.machine import available_cores

ATTEMPTS: Final = 5
"""Times in a row that work may be lost with its worker without anything having been found."""
GRACE: Final = 2.0
"""Seconds that workers may take to end."""
Kind = Literal["item", "done", "error"]


def started(place: str, sharing: int = 1) -> tuple[subprocess.Popen[bytes], Connection]:
    """A process that calls a function with the number of a pipe's end, and the other end.

    Args:
        place: of the function, "module:function".
        sharing: how many such processes there are: their libraries share the cores.
    """
    ours, theirs = Pipe()
    number = str(max(available_cores() // sharing, 1))
    threads = {f"{library}_NUM_THREADS": number for library in ("OMP", "OPENBLAS", "MKL")}
    module, _, function = place.partition(":")
    code = f"import sys; sys.path[:] = {sys.path!r}; from {module} import {function}; {function}({theirs.fileno()})"
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-c", code], pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL,
            env=threads | os.environ, start_new_session=True,
        )  # fmt: skip
    return process, ours


class _Worker:
    """A process and the pipe to it."""

    def __init__(self, workers: int) -> None:
        self.process, self.pipe = started("agents.processes.pool:serve", workers)


class Pool:
    """Up to so many workers, which stay for the next call.

    Args:
        size: how many at most.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.kept = True
        """Whether another call may come; a pool that is not kept ends its workers after this one."""
        self._idle: list[_Worker] = []
        self._busy: dict[Any, tuple[_Worker, int]] = {}

    @property
    def busy(self) -> bool:
        """Whether tasks are being done."""
        return bool(self._busy)

    def stream(self, function: Callable[[Any], Iterable[Any]], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Pairs of a task and an item that the function gives for it, as they come, of all tasks in any order.

        A task that was lost with its worker runs again; items that it gave before are not given again, which takes
        that it gives the same ones in the same order.

        Raises:
            RuntimeError: workers are lost again and again.
        """
        left, attempts, given, skip = deque(enumerate(tasks)), 0, Counter[int](), Counter[int]()
        work = cloudpickle.dumps(function)
        try:
            while left or self._busy:
                while left and len(self._busy) < self.size:
                    self._begin(work, *left.popleft())
                for pipe in wait(list(self._busy)):
                    worker, number = self._busy[pipe]
                    try:
                        kind, content = pickle.loads(worker.pipe.recv_bytes())
                    except (EOFError, OSError):
                        attempts += 1
                        self._lost(pipe, attempts, len(left) + len(self._busy))
                        left.append((number, tasks[number]))
                        skip[number] = given[number]
                        continue
                    attempts = 0
                    if kind == "item" and skip[number]:
                        skip[number] -= 1
                    elif kind == "item":
                        given[number] += 1
                        yield tasks[number], content
                    else:
                        self._idle.append(self._busy.pop(pipe)[0])
                        if kind == "error":
                            raise content
        finally:
            if self._busy or not self.kept:  # nobody waits for what they do
                self.stop()

    def _begin(self, work: bytes, number: int, task: Any) -> None:
        worker = self._idle.pop() if self._idle else _Worker(self.size)
        self._busy[worker.pipe] = worker, number
        with suppress(OSError):  # a worker that died since is found to be lost where it is waited for
            worker.pipe.send_bytes(cloudpickle.dumps((work, task)))

    def _lost(self, pipe: Any, attempts: int, tasks: int) -> None:
        worker, _ = self._busy.pop(pipe)
        pipe.close()
        worker.process.kill()
        status = worker.process.wait()
        if attempts >= ATTEMPTS:
            raise RuntimeError(f"workers were lost {ATTEMPTS} times without finishing anything")
        warnings.warn(f"a worker was lost (exit status {status}): {tasks} tasks go on", stacklevel=3)

    def stop(self) -> None:
        """End all workers."""
        workers = [*self._idle, *(worker for worker, _ in self._busy.values())]
        self._idle, self._busy = [], {}
        for worker in workers:
            worker.pipe.close()
        deadline = time.monotonic() + GRACE
        for worker in workers:
            try:
                worker.process.wait(max(deadline - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                worker.process.kill()
                worker.process.wait()


_POOLS: dict[int, Pool] = {}


def pool_of(size: int) -> Pool:
    """This process' pool; one of another size is ended, one that is still read from is left to its reader."""
    here = os.getpid()  # what was forked from this process has none
    pool = _POOLS.get(here)
    if pool is None or pool.size != size or pool.busy:
        if pool is not None and pool.busy:
            pool.kept = False
        elif pool is not None:
            pool.stop()
        _POOLS[here] = pool = Pool(size)
    return pool


@atexit.register
def stop_pool() -> None:
    """End this process' workers, if there are any."""
    pool = _POOLS.pop(os.getpid(), None)
    if pool is not None:
        pool.stop()


def serve(descriptor: int) -> None:
    """A worker's life: do what comes through the pipe until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
    pipe, orders = Connection(descriptor), queue.SimpleQueue[bytes]()
    threading.Thread(target=_listen, args=(pipe, orders), daemon=True).start()
    with suppress(SystemExit, OSError):
        while True:
            _obey(pipe, orders.get())
    os._exit(1)


def _listen(pipe: Connection, orders: queue.SimpleQueue[bytes]) -> None:
    with suppress(EOFError, OSError):
        while True:
            orders.put(pipe.recv_bytes())
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
    time.sleep(GRACE / 2.0)
    os._exit(1)


def _end(*_: object) -> None:
    sys.unraisablehook = lambda _: None  # where it is swallowed, _listen's patience ends
    sys.exit(1)  # half a file is removed on the way out


def _obey(pipe: Connection, order: bytes) -> None:
    def send(kind: Kind, content: Any) -> None:
        pipe.send_bytes(cloudpickle.dumps((kind, content)))

    try:
        work, task = pickle.loads(order)
        for item in pickle.loads(work)(task):
            send("item", item)
    except Exception as error:
        send("error", _sendable(error))
    else:
        send("done", None)


def _sendable(error: Exception) -> Exception:
    """The error with where it was raised; a plain one in its place if it does not survive the way."""
    error.add_note("in a worker:\n" + "".join(traceback.format_exception(error)))
    try:
        pickle.loads(cloudpickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
