"""Runs tasks in this process, in worker processes of this machine (loky), or on a Ray cluster, with joblib.

Tasks of a lost worker are run again.
"""

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Final, Literal

import tyro
from tqdm import tqdm

Backend = Literal["local", "ray"]
ATTEMPTS: Final = 5
"""Maximum number of losses of workers without a result between them."""
WAVE: Final = 2
"""Tasks per worker in one call of Ray, which returns the results of a call together."""
LOST: Final = (
    "TerminatedWorkerError", "BrokenProcessPool",
    "RayActorError", "ActorDiedError", "ActorUnavailableError", "WorkerCrashedError", "NodeDiedError",
)  # fmt: skip
"""Errors of a lost process or node."""


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
        return ((task, function(task)) for task in tasks) if self.here else self._parallel(function, tasks)

    def _parallel(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        import joblib

        parent = os.getpid() if self.backend == "local" else None
        remaining, losses = dict(enumerate(tasks)), 0
        with self._backend() as (available, wave, options):
            while remaining:
                part = list(remaining.items())[: wave and wave * available()]
                calls = [joblib.delayed(_numbered)(parent, function, number, task) for number, task in part]
                results = joblib.Parallel(available(), batch_size=1, **options)(calls)
                try:
                    for number, result in results:
                        losses = 0
                        yield remaining.pop(number), result
                except Exception as error:
                    if type(error).__name__ not in LOST:
                        raise
                    losses += 1
                    if losses == ATTEMPTS:
                        raise RuntimeError(f"workers were lost {ATTEMPTS} times without a result") from error
                    text = f"a worker was lost ({type(error).__name__}): {len(remaining)} tasks continue"
                    warnings.warn(text, stacklevel=2)
                finally:
                    if self.backend == "local":  # joblib warns of cancelled tasks
                        with warnings.catch_warnings(action="ignore"):
                            results.close()

    @contextmanager
    def _backend(self) -> Iterator[tuple[Callable[[], int], int | None, dict[str, Any]]]:
        """Function for the number of available workers, tasks per worker and call, and joblib options."""
        if self.backend == "local":  # results in any order; arrays are copied to the workers
            yield lambda: self.jobs, None, {"backend": "loky", "return_as": "generator_unordered", "max_nbytes": None}
            return
        try:
            import joblib
            import ray
            from ray.util.joblib import register_ray
        except ImportError as error:
            raise RuntimeError(f"backend = 'ray' needs the extra probe-env[ray]: {error}") from error
        if not ray.is_initialized():
            ray.init(address=self.address, log_to_driver=False)
        register_ray()

        def available() -> int:  # a pool of more CPUs than available would wait for ever
            return max(min(self.jobs, int(ray.cluster_resources().get("CPU", 1))), 1)

        with joblib.parallel_config(backend="ray"):
            yield available, WAVE, {}


HERE = Workers()
"""This process."""


def _numbered(parent: int | None, function: Callable[[Any], Any], number: int, task: Any) -> tuple[int, Any]:
    if parent is not None:
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
