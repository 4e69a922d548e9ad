"""Runs tasks in this process, in worker processes of this machine (joblib with loky), or on a Ray cluster.

Tasks of a lost worker are run again.
"""

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Final, Literal

import tyro
from tqdm import tqdm

Backend = Literal["local", "ray"]
ATTEMPTS: Final = 5
"""Maximum number of losses of workers: without a result between them, on a cluster with the same task."""


@dataclass(frozen=True)
class Workers:
    """Number of workers and where they run.

    Attributes:
        jobs: Number of workers; 1 with the local backend: this process.
        backend: local: processes on this machine; ray: a Ray cluster.
        address: Address of the Ray cluster; default: the cluster of this machine, or a new one on it.
    """

    jobs: int = 1
    backend: Backend = "local"
    address: Annotated[str | None, tyro.conf.arg(help_behavior_hint="")] = None

    def __post_init__(self) -> None:
        if not 1 <= self.jobs <= 100_000:
            raise ValueError(f"jobs = {self.jobs!r} is outside the accepted range 1 to 100000")
        if self.address is not None and self.backend != "ray":
            raise ValueError(f"address = {self.address!r} needs backend = 'ray' (now {self.backend!r})")

    @property
    def here(self) -> bool:
        """Whether tasks run in this process."""
        return self.jobs == 1 and self.backend == "local"

    def map(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Pairs of task and result in the order in which they finish.

        Raises:
            RuntimeError: the backend is not installed, or workers are lost ``ATTEMPTS`` times.
        """
        if self.here:
            return ((task, function(task)) for task in tasks)
        return self._on_cluster(function, tasks) if self.backend == "ray" else self._in_processes(function, tasks)

    def _in_processes(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        from joblib import Parallel, delayed

        parent, remaining, losses = os.getpid(), dict(enumerate(tasks)), 0
        while remaining:
            calls = [delayed(_numbered)(parent, function, *item) for item in remaining.items()]
            # in any order; arrays are copied to the workers
            results = Parallel(self.jobs, "loky", return_as="generator_unordered", batch_size=1, max_nbytes=None)(calls)
            try:
                for number, result in results:
                    losses = 0
                    yield remaining.pop(number), result
            except BrokenExecutor as error:
                losses += 1
                if losses == ATTEMPTS:
                    raise RuntimeError(f"workers were lost {ATTEMPTS} times without a result") from error
                text = f"a worker was lost ({type(error).__name__}): {len(remaining)} tasks continue"
                warnings.warn(text, stacklevel=2)
            finally:
                with warnings.catch_warnings(action="ignore"):  # of joblib about cancelled tasks
                    results.close()

    def _on_cluster(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        try:
            import ray
        except ImportError as error:
            raise RuntimeError(f"backend = 'ray' needs the extra probe-env[ray]: {error}") from error
        if not ray.is_initialized():
            ray.init(address=self.address, log_to_driver=False)
        run = ray.remote(max_retries=ATTEMPTS - 1)(lambda function, task: function(task))
        shared, waiting = ray.put(function), list(reversed(tasks))
        running: dict[Any, Any] = {}  # reference to the result -> task
        try:
            while waiting or running:
                while waiting and len(running) < self.jobs:
                    task = waiting.pop()
                    running[run.remote(shared, task)] = task
                (finished,), _ = ray.wait(list(running))
                yield running.pop(finished), ray.get(finished)
        except ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except ray.exceptions.RayError as error:
            raise RuntimeError(f"the cluster has no result of a task after {ATTEMPTS} attempts: {error}") from error
        finally:
            for left in running:
                ray.cancel(left, force=True)


HERE = Workers()
"""This process."""


def _numbered(parent: int, function: Callable[[Any], Any], number: int, task: Any) -> tuple[int, Any]:
    _set_up(parent)
    return number, function(task)


@cache
def _set_up(parent: int) -> None:
    """Ignore Ctrl-C, which the parent handles, and end this worker when the parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tqdm.set_lock(threading.RLock())  # the default is a system semaphore, which a killed worker would not release

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
