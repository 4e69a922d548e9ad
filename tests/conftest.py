"""Seeds that a run can shift, rounding of another processor, and what is left out unless asked for or installed."""

import os
import shutil
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from probe_env import Simulator

NUDGE = 1e-15
"""[m], far below what a float sinks into a wall: after a step it is a change of the last digits."""
AGENT_LIBRARIES = frozenset({"torch", "stable_baselines3", "sb3_contrib"})

MEMORY, ROOM = Path("/dev/shm"), 2e9
"""Where temporary files lie if there is so much room [B]: what is stored is synced, for which tests of kills wait more
than they compute."""

Seeds = Callable[[int], Sequence[int]]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--shift-seeds", type=int, default=0, metavar="N",
        help="statistical tests draw the N-th other set of seeds, and runs begin with other last digits",
    )  # fmt: skip


def pytest_configure() -> None:
    """A script that starts the tests in its background, or under nohup, has these ignored; tests send them."""
    if os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > ROOM:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session")
def seeds(request: pytest.FixtureRequest) -> Seeds:
    """So many seeds: none that a stored result used, and others under every ``--shift-seeds``."""
    first = 10_000 * (1 + request.config.getoption("--shift-seeds"))
    return lambda count: range(first, first + count)


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Run a command that must be refused in one line about a file, and change nothing; gives that line."""
    from poisons import fingerprint

    from probe_agents.cli import main

    monkeypatch.chdir(tmp_path)

    def run(arguments: Sequence[object], *messages: str) -> str:
        before = fingerprint(tmp_path)
        assert main(list(map(str, arguments))) == 2
        printed = capsys.readouterr()
        assert printed.out == "" or printed.out.startswith("one schedule, ")  # what evaluate does
        assert printed.err.count("\n") == 1, printed.err
        assert printed.err.startswith("probe-env: error: ")
        assert printed.err.strip().isprintable()
        for text in messages:
            assert text in printed.err
        assert fingerprint(tmp_path) == before
        return printed.err

    return run


@pytest.fixture(autouse=True, scope="module")
def rounding_of_another_processor(request: pytest.FixtureRequest) -> Iterator[None]:
    """Under ``--shift-seeds`` every probe starts a femtometre off, as if the first step had been rounded otherwise."""
    shift = request.config.getoption("--shift-seeds")
    with pytest.MonkeyPatch.context() as patch:
        if shift:
            reset = Simulator.reset

            def nudged(self: Simulator) -> None:
                reset(self)
                self.state.d[: self.root, 1] += NUDGE * np.random.default_rng(shift).normal(size=self.root)

            patch.setattr(Simulator, "reset", nudged)
        yield


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """``long`` tests begin first; ``boundscheck`` compiles for minutes: only with its file or ``-m boundscheck``."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)  # or one process ends long after the other
    if "boundscheck" in config.option.markexpr or any("test_bounds" in str(argument) for argument in config.args):
        return
    left_out = [item for item in items if item.get_closest_marker("boundscheck")]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]


if find_spec("torch") is None:  # the physics and the environments are tested all the same

    def pytest_report_header() -> str:
        return "torch is not installed: tests that need it or an agent library are skipped"

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
        """A file that imports what is missing is skipped."""
        report = yield
        if report.failed and any(f"No module named '{name}" in str(report.longrepr) for name in AGENT_LIBRARIES):
            report.outcome = "skipped"
            report.longrepr = (str(collector.path), 0, "Skipped: torch is not installed")
        return report

    def skipping() -> Generator[None, object, object]:
        """So is a test that comes to need it, itself or by what is set up for it."""
        try:
            return (yield)
        except ModuleNotFoundError as error:
            if (error.name or "").split(".")[0] in AGENT_LIBRARIES:
                pytest.skip("torch is not installed")
            raise

    pytest_runtest_setup = pytest.hookimpl(wrapper=True)(skipping)
    pytest_runtest_call = pytest.hookimpl(wrapper=True)(skipping)
