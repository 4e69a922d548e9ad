"""Where work runs: in this process, in processes of this machine, or on a Ray cluster.

``pool`` runs processes here, joblib and Ray those of a cluster. What is lost with a worker is done again.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import joblib

from agents.processes.pool import ATTEMPTS, pool_of

Backend = Literal["local", "ray"]
WAVE = 2
"""Tasks a worker in one call of Ray, which hands results back when all of a call are there."""


@dataclass(frozen=True)
class Workers:
    """How many workers, and where.

    Attributes:
        jobs: workers at the same time; 1 with "local" is this very process.
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
        """Pairs of task and result as they finish, in any order; a task that was lost with its worker runs again.

        Raises:
            RuntimeError: the backend is not installed, or workers are lost again and again.
        """
        return self.stream(partial(_once, function), tasks)

    def stream(self, function: Callable[[Any], Iterable[Any]], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Pairs of a task and an item that the function gives for it; each as it comes, with Ray when the task ends.

        A task that was lost with its worker runs again. It must give the same items in the same order then, of which
        those that came before are left out.

        Raises:
            RuntimeError: the backend is not installed, or workers are lost again and again.
        """
        if self.backend == "ray" or (os.name == "nt" and not self.here):  # the pool's pipes are POSIX'
            for task, items in self._through_joblib(partial(_gathered, function), tasks):
                yield from ((task, item) for item in items)
        elif self.here:
            for task in tasks:
                yield from ((task, item) for item in function(task))
        else:
            yield from pool_of(self.jobs).stream(function, tasks)

    def _through_joblib(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        left, attempts = dict(enumerate(tasks)), 0
        with self._cluster() as at_once:
            while left:
                before = len(left)
                try:
                    calls = [joblib.delayed(_numbered)(function, number, task) for number, task in left.items()]
                    wave = calls[: WAVE * at_once()]
                    for number, result in joblib.Parallel(n_jobs=at_once(), batch_size=1)(wave):
                        yield left.pop(number), result
                except Exception as error:
                    if not _worker_lost(error):
                        raise
                    attempts = attempts + 1 if len(left) == before else 0
                    if attempts >= ATTEMPTS:
                        raise RuntimeError(f"workers were lost {ATTEMPTS} times without finishing anything") from error
                    warnings.warn(f"a worker was lost ({type(error).__name__}): {len(left)} tasks go on", stacklevel=2)

    @contextmanager
    def _cluster(self) -> Iterator[Callable[[], int]]:
        """Ray as joblib's backend, or processes here; how many can work just now."""
        if self.backend == "local":
            yield lambda: self.jobs
            return
        try:
            import ray
            from ray.util.joblib import register_ray
        except ImportError as error:
            raise RuntimeError(f"backend = 'ray' needs the extra probe-env[ray]: {error}") from error
        if not ray.is_initialized():
            ray.init(address=self.address, log_to_driver=False)
        register_ray()

        def at_once() -> int:  # a pool that asks for more CPUs than are left would wait for ever
            return max(min(self.jobs, int(ray.cluster_resources().get("CPU", 1))), 1)

        with joblib.parallel_config(backend="ray"):
            yield at_once


HERE = Workers()
"""This very process."""


def _once(function: Callable[[Any], Any], task: Any) -> Iterator[Any]:
    yield function(task)


def _gathered(function: Callable[[Any], Iterable[Any]], task: Any) -> list[Any]:
    return list(function(task))


def _numbered(function: Callable[[Any], Any], number: int, task: Any) -> tuple[int, Any]:
    return number, function(task)


def _worker_lost(error: BaseException) -> bool:
    """Whether an error says that a process or a node is gone, and nothing about the work itself."""
    lost = ("RayActorError", "ActorDiedError", "ActorUnavailableError", "WorkerCrashedError", "NodeDiedError")
    return type(error).__name__ in lost
