"""No kernel reads or writes beyond an array: numba's own check, and guards about what the lanes load by address.

``pytest tests/physics/test_bounds.py`` runs both; without its name the first, which compiles for minutes, is left out.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from probe_env import Scene, SimulatorBatch
from probe_env.physics.methods import METHODS

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
KERNEL = re.compile(r"^@(njit\(cache=True|kernel\b)", re.MULTILINE)
CANARY = """
import numba, numpy
beyond = numba.njit(lambda x: x[len(x)])
try:
    beyond(numpy.zeros(3))
except IndexError:
    print("checked")
"""


def sources(path):
    """Text of a file, or of all in a folder of a method."""
    return "".join(file.read_text() for file in ([path] if path.suffix == ".py" else path.glob("*.py")))


@pytest.mark.boundscheck
def test_numba_finds_no_index_out_of_bounds(tmp_path):
    """In a cache of its own: kernels compiled with and without the flag must not mix."""
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    for arguments, expected in ((["-c", CANARY], "checked"), ([str(ROOT / "tests" / "every_kernel.py")], "101")):
        done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert done.stdout.strip() == expected
    index = list(tmp_path.rglob("*.nbi"))  # <folder>_<hash>/<file>.<kernel>-<line>...
    compiled = {path.name.split(".")[0] for path in index} | {path.parent.name.rpartition("_")[0] for path in index}
    folder = ROOT / "probe_env" / "physics" / "methods"
    rooms = {path.stem for path in folder.iterdir() if KERNEL.search(sources(path))}
    assert {"ticm", "imex", "superelement"} <= rooms
    assert compiled >= rooms | {"drive"}


GUARD = 4096
"""Entries before and behind each array; NaN, so that what is read there shows in the result."""


def guarded(kernel, calls):
    """A kernel whose arrays, also those in tuples, lie between guards."""

    def call(*arguments):
        buffers = []

        def fence(argument):
            if type(argument) is tuple:
                return tuple(map(fence, argument))
            if not isinstance(argument, np.ndarray):
                return argument
            sentinel = np.nan if argument.dtype.kind == "f" else -(10**6)
            buffer = np.full(argument.size + 2 * GUARD, sentinel, dtype=argument.dtype)
            inside = buffer[GUARD : GUARD + argument.size].reshape(argument.shape)
            inside[...] = argument
            buffers.append((argument, inside, buffer))
            return inside

        result = kernel(*map(fence, arguments))
        for k, (array, inside, buffer) in enumerate(buffers):
            edges = np.concatenate([buffer[:GUARD], buffer[-GUARD:]])
            untouched = np.isnan(edges) if edges.dtype.kind == "f" else edges == -(10**6)
            assert untouched.all(), f"array {k} of {kernel.py_func.__name__}"
            array[...] = inside
        calls.append(len(buffers))
        return result

    return call


@pytest.mark.parametrize("method", ["imex", "imex32", "explicit", "superelement", "superelement32"])
@pytest.mark.parametrize("count", range(1, 9))
def test_the_lanes_stay_within_their_arrays(method, count, monkeypatch):
    """Lanes are loaded by address, which numba does not check: probes of all lengths, growing to the helix's end."""
    step = 5e-6 if method == "explicit" else 2e-4
    terms = {"shortening": True, "stiction": True} if count > 4 and METHODS[method].simulates_terms else {}
    scenes = [
        Scene(
            tube={"helix_length": 0.75 + s},
            probe={"guide_length": 0.1 * (k % 3)},
            carrier_length=0.3 + s,
            terms=terms,
            contact={"weight": "shortening" in terms},
            air={"compressible": "shortening" in terms},
        )
        for k, s in enumerate(0.1 * np.arange(count))
    ]
    results, kind, calls = [], type(METHODS[method]), []
    for name in {"kernel", "single"} & set(dir(kind)):
        monkeypatch.setattr(kind, name, staticmethod(guarded(getattr(kind, name), calls)))
    for _ in range(2):  # the guarded first: it names what it finds
        batch = SimulatorBatch(scenes, method, step, growing=True, time_lapse=1000.0, perturbation=1e-6, threads=1)
        batch.advance(0.25, 0.03, 480 * step, 8 * step)
        active = np.arange(count) % 3 != 1
        results.append((batch, batch.advance(0.25, 0.03, 4 * step, step, active, keep_samples=True)))
        monkeypatch.undo()
    assert calls
    (fenced, second), (plain, first) = results
    assert not first.diverged.any()
    assert (first.radial == second.radial).all()
    assert (first.tension == second.tension).all()
    for one, other in zip(plain.simulators, fenced.simulators, strict=True):
        assert one.root == other.root == one.chain.node_count - 1
        assert all(map(np.array_equal, one.state, other.state))
