"""The numbers of user commands and environments, by value: a small set of what `compare.py` records bit by bit.

    python tests/golden/test_golden.py    write expected.json again, with the bounds (2 min of a core)

Contacts make the motion chaotic at every length: a start that is 1e-15 m off changes tensions by 1e-9 after 0.1 s and
some vibrations by their own size after 0.5 s. So each column has its own bound, derived from `NUDGES` such starts (what
another processor rounds otherwise is of that size), see `bound`. Columns that are chaotic in full are left out.
"""

import json
import math
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from compare import IGNORED_FILES, INPUTS, columns_of, settings_of, steps

from probe_agents.cli import main
from probe_env import Simulator

EXPECTED = Path(__file__).parent / "expected.json"
CALM = "--tube calm.toml --fidelity fast --output out"
STEPS = "fidelity=fast tube=calm.toml"
CASES = {
    "simulate-newmark": "simulate fig11_l10 --method newmark --duration 0.05 --output out",
    "simulate-imex": "simulate fig11_l10 --method imex --duration 0.2 --scene.contact.friction 0.2 --output out",
    "simulate-superelement": "simulate fig11_l10 --method superelement --duration 0.125 --output out",
    "evaluate": f"evaluate constant pi adaptive plc-integral calm.csv --limit 2 {CALM}",
    "evaluate-agents": f"evaluate student --limit 1 {CALM}",
    "signal": "signal best-schedule --fidelity standard --tube short.toml --flaws 5.5:20 6:60 --until 9 --output out",
    "compare": "compare original improved --full --tube longer.toml --limit 1 --fidelity fast --output out",
    "log": "log rig.csv --output out/clean.csv",
    "calibrate": "calibrate rig.csv --output out",
    "plc": "plc --st out/law.st --csv out/law.csv",
    "plc-integral": "plc --integral --st out/integral.st --tube short.toml",
    "steps-insertion": f"steps Insertion-v1 6 {STEPS}",
    "steps-complete": "steps Insertion-v1 45 fidelity=fast tube=short.toml",
    "steps-time-limit": f"steps Inspection-v0 6 {STEPS} config.time_limit=4",
    "steps-snapshot": "steps Snapshot-v1 6 fidelity=standard tube=calm.toml",
    "steps-inspection": f"steps Inspection-v0 6 {STEPS}",
    "steps-design": "steps Design-v1 1 fidelity=standard",
}
KEPT = 16
"""Cells of a column that are compared, spread evenly over it."""
ENDS = re.compile(r"terminated$|truncated$|done$|reward$|inserted_length$")
"""What is compared of the cases in which episodes end, and then all cells of it."""
SUFFIXES = {".csv", ".parquet", ".json", ".npz", ".st"}
LEFT_OUT = {"noise_gaussian"}  # whether a p-value is above its limit, from noise that is chaotic
NUDGES = 8
MIN_BOUND, MAX_BOUND = 1e-6, 0.5
"""Bounds: of float32 observations that are rounded otherwise; and above which a column is left out."""
Columns = dict[str, list[float | str]]


def values(name: str, folder: Path, shift: int = 0) -> Columns:
    """Run a case in a folder; "file, column" and the cells of all that it stores, numbers rounded to ten digits.

    ``shift`` adds a digit to the tensions of the log, which sends the random walks of a calibration another way.
    """
    shutil.copytree(INPUTS, folder, dirs_exist_ok=True)
    if shift and name == "calibrate":
        text = (folder / "rig.csv").read_text("latin-1")
        (folder / "rig.csv").write_text(re.sub(r"(;\d+,\d\d);", rf"\g<1>{shift};", text), "latin-1")
    (folder / "out").mkdir()
    words, before = CASES[name].split(), Path.cwd()
    os.chdir(folder)
    try:
        if words[0] == "steps":
            steps(words[1], int(words[2]), settings_of(words[3:]))
        else:
            assert main(words) == 0
    finally:
        os.chdir(before)
    ends = name in ("steps-complete", "steps-time-limit")
    kept = 200 if ends else KEPT
    files = [path for path in sorted(folder.glob("out/**/*")) if path.suffix in SUFFIXES]
    return {
        f"{path.relative_to(folder)}, {column}": [cell_of(cell) for cell in cells[:: max(1, len(cells) // kept)]]
        for path in files
        if not IGNORED_FILES.search(path.name) and path.name != "setting.json"
        for column, cells in columns_of(path).items()
        if column not in LEFT_OUT and (not ends or ENDS.search(column))
    }


def cell_of(text: str) -> float | str:
    """A number where it is one; cells of `steps` begin with "step 3: "."""
    try:
        return float(f"{float(text.rpartition(': ')[2]):.10g}")
    except ValueError:
        return text


def deviation(expected: list[float | str], found: list[float | str] | None) -> float:
    """Largest deviation of a column relative to its largest magnitude; infinite where texts or finiteness differ."""
    if found is None or [type(cell) for cell in expected] != [type(cell) for cell in found]:
        return math.inf
    texts, numbers = [], []
    for pair in zip(expected, found, strict=True):
        (texts if isinstance(pair[0], str) else numbers).append(pair)
    one, other = np.array(numbers, dtype=float).reshape(-1, 2).T
    finite = np.isfinite(one)
    if any(cell != another for cell, another in texts) or (finite != np.isfinite(other)).any():
        return math.inf
    scale = np.abs(one[finite]).max(initial=0.0) or 1.0
    return float(np.abs(one - other)[finite].max(initial=0.0) / scale)


def bound(spread: float) -> float:
    """Of a column with this largest deviation among the nudged starts.

    Below 1e-4 a deviation still grows exponentially, so its logarithm scatters: a hundredfold. Above, it is of the size
    of the motion's own scatter, which does not grow any more but has long tails: tenfold, and at least 5 %.
    """
    return max(MIN_BOUND, 100.0 * spread if spread < 1e-4 else max(0.05, 10.0 * spread))


@pytest.mark.processor
@pytest.mark.parametrize("name", CASES)
def test_numbers_are_those_of_the_base_commit(name, tmp_path):
    found = values(name, tmp_path)
    off = {
        column: (distance, largest)
        for column, (largest, *expected) in json.loads(EXPECTED.read_text())[name].items()
        if (distance := deviation(expected, found.get(column))) > largest
    }
    assert not off, f"{len(off)} columns are further off than their bounds: {off}"


def nudge(reset: Callable[[Simulator], None], shift: int) -> None:
    """Let every probe start a femtometre off from now on, as `rounding_of_another_processor` in conftest.py does."""

    def nudged(self: Simulator) -> None:
        reset(self)
        self.state.d[: self.root, 1] += 1e-15 * np.random.default_rng(shift).normal(size=self.root)

    Simulator.reset = nudged if shift else reset  # type: ignore[method-assign]


def write_expected(names: list[str]) -> None:
    """Write cases, default all, to expected.json: {case: {"file, column": [bound, cell, cell, ...]}}."""
    reset, stored = Simulator.reset, json.loads(EXPECTED.read_text()) if names else {}
    for name in names or CASES:
        runs = []
        for shift in range(1 + NUDGES * (name.partition("-")[0] not in ("log", "plc"))):
            nudge(reset, shift)
            with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                runs.append(values(name, Path(folder), shift))
        bounds = {
            column: bound(max((deviation(cells, run.get(column)) for run in runs[1:]), default=0.0))
            for column, cells in runs[0].items()
        }
        stored[name] = {
            column: [float(f"{bounds[column]:.1g}"), *cells]
            for column, cells in runs[0].items()
            if bounds[column] < MAX_BOUND
        }
        print(f"{name}: {len(stored[name])} of {len(bounds)} columns are compared")
    EXPECTED.write_text(json.dumps(stored, separators=(",", ":")).replace("},", "},\n").replace("],", "],\n") + "\n")


if __name__ == "__main__":
    write_expected(sys.argv[1:])
