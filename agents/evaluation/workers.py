"""Runs tasks in this process, in worker processes of this machine (loky), or on a Ray cluster (joblib).

Tasks that were running in a worker that was lost are run again.
"""

from __future__ import annotations

import os
import pickle
import signal
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import count, islice
from pathlib import Path
from typing import Any, Final, Literal

import cloudpickle
from tqdm import tqdm

from probe_env.machine import available_cores

Backend = Literal["local", "ray"]
ATTEMPTS: Final = 5
"""Losses of workers in a row, without any result between them, until work is given up."""
POLL: Final = 0.1
"""Seconds between two looks for items of running tasks."""
WAVE: Final = 2
"""Tasks per worker in one call of Ray, which returns results when all of a call are there."""
LOST: Final = (
    "TerminatedWorkerError", "BrokenProcessPool",
    "RayActorError", "ActorDiedError", "ActorUnavailableError", "WorkerCrashedError", "NodeDiedError",
)  # fmt: skip
"""Errors that say that a process or a node is gone, and nothing about the work."""


@dataclass(frozen=True)
class Workers:
    """Number and place of workers.

    Attributes:
        jobs: workers at the same time; 1 with "local" is this process itself.
        backend: "local" or "ray".
        address: of the Ray cluster; None: the one that this machine belongs to, or a new one on it.
    """

    jobs: int = 1
    backend: Backend = "local"
    address: str | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.jobs <= 100_000:
            raise ValueError(f"jobs = {self.jobs!r} is outside the accepted range 1 to 100000")
        if self.address is not None and self.backend != "ray":
            raise ValueError(f"address = {self.address!r} is for backend = 'ray' (given: {self.backend!r})")

    @property
    def here(self) -> bool:
        """Whether the work stays in this process."""
        return self.jobs == 1 and self.backend == "local"

    def map(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Pairs of task and result as they finish, in any order.

        Raises:
            RuntimeError: the backend is not installed, or workers are lost again and again.
        """
        return self.stream(lambda task: [function(task)], tasks)

    def stream(self, function: Callable[[Any], Iterable[Any]], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Pairs of a task and an item that the function yields for it, as they come; with Ray when the task ends.

        A task must yield the same items in the same order when it runs again: those that came before are skipped.

        Raises:
            RuntimeError: the backend is not installed, or workers are lost again and again.
        """
        if self.here:
            return ((task, item) for task in tasks for item in function(task))
        return self._on_cluster(function, tasks) if self.backend == "ray" else _in_processes(self.jobs, function, tasks)

    def _on_cluster(self, function: Callable[[Any], Iterable[Any]], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        import joblib

        left, losses = dict(enumerate(tasks)), 0
        with self._cluster() as free_workers:
            while left:
                wave = list(left.items())[: WAVE * free_workers()]
                calls = [joblib.delayed(_gathered)(function, number, task) for number, task in wave]
                try:
                    for number, items in joblib.Parallel(n_jobs=free_workers(), batch_size=1)(calls):
                        losses, task = 0, left.pop(number)
                        yield from ((task, item) for item in items)
                except Exception as error:
                    losses = _checked_loss(error, losses, len(left))

    @contextmanager
    def _cluster(self) -> Iterator[Callable[[], int]]:
        """Ray as joblib's backend; gives a function that counts the workers available now."""
        try:
            import joblib
            import ray
            from ray.util.joblib import register_ray
        except ImportError as error:
            raise RuntimeError(f"backend = 'ray' needs the extra probe-env[ray]: {error}") from error
        if not ray.is_initialized():
            ray.init(address=self.address, log_to_driver=False)
        register_ray()

        def free_workers() -> int:  # a pool that asks for more CPUs than there are would wait for ever
            return max(min(self.jobs, int(ray.cluster_resources().get("CPU", 1))), 1)

        with joblib.parallel_config(backend="ray"):
            yield free_workers


HERE = Workers()
"""This process itself."""


def _gathered(function: Callable[[Any], Iterable[Any]], number: int, task: Any) -> tuple[int, list[Any]]:
    return number, list(function(task))


def _checked_loss(error: Exception, losses: int, left: int) -> int:
    """Losses in a row, this one included; raises what is no loss of a worker, and after too many."""
    if type(error).__name__ not in LOST:
        raise error
    if losses + 1 >= ATTEMPTS:
        raise RuntimeError(f"workers were lost {ATTEMPTS} times without finishing anything") from error
    warnings.warn(f"a worker was lost ({type(error).__name__}): {left} tasks go on", stacklevel=3)
    return losses + 1


def _in_processes(
    jobs: int, function: Callable[[Any], Iterable[Any]], tasks: Sequence[Any]
) -> Iterator[tuple[Any, Any]]:
    """Items of all tasks from worker processes, which stay for the next call; they hand items over as files."""
    from joblib.externals.loky import get_reusable_executor

    work, left, received, losses = cloudpickle.dumps(function), dict(enumerate(tasks)), Counter[int](), 0
    cores = str(max(available_cores() // jobs, 1))
    threads = {
        f"{name}_NUM_THREADS": os.environ.get(f"{name}_NUM_THREADS", cores) for name in ("OMP", "OPENBLAS", "MKL")
    }
    with tempfile.TemporaryDirectory(prefix="probe-env-") as folder:
        while left:
            executor = get_reusable_executor(jobs, env=threads)
            running = {
                executor.submit(_work, os.getpid(), work, task, received[number], Path(folder, str(number))): number
                for number, task in left.items()
            }
            try:
                while running:
                    ended, _ = wait(running, POLL, FIRST_COMPLETED)
                    for number, item in _arrived(folder):
                        received[number], losses = received[number] + 1, 0
                        yield tasks[number], item
                    for future in ended:
                        number = running.pop(future)
                        future.result()
                        del left[number]
            except Exception as error:
                losses = _checked_loss(error, losses, len(left))
            finally:
                if running:  # nobody waits for them
                    executor.shutdown(kill_workers=True)


def _arrived(folder: str) -> Iterator[tuple[int, Any]]:
    for path in sorted(Path(folder).glob("*.item"), key=lambda path: int(path.name.split(".")[1])):
        content = pickle.loads(path.read_bytes())
        path.unlink()
        yield int(path.name.split(".")[0]), content


def _work(parent: int, work: bytes, task: Any, skip: int, place: Path) -> None:
    """In a worker: store every item of a task as a file; a hidden file is renamed once it is whole."""
    _set_up(parent)
    for number, item in zip(count(skip), islice(pickle.loads(work)(task), skip, None), strict=False):
        hidden = place.with_name(f".{place.name}")
        hidden.write_bytes(cloudpickle.dumps(item))
        hidden.rename(place.with_name(f"{place.name}.{number}.item"))


@cache
def _set_up(parent: int) -> None:
    """Let this worker ignore Ctrl-C, which its parent handles, and end when the parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tqdm.set_lock(threading.RLock())  # its own is a semaphore of the system, which a killed worker would leave behind

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
