"""A row of every kind and method of the chart's tables, of short runs; for ``probe-env results chart --confirm``."""

import hashlib
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from agents.chart import ensembles, insertions, smooth
from agents.records.code_hash import code_hash

FOLDER = Path(sys.argv[1])
STEPS = {"implicit": 1e-4, "newmark": 1e-4}


def main() -> None:
    """Write ensembles.csv, insertions.csv and smooth.csv, each row with the hash of the code that it depends on."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    ensembles.SETTLE = ensembles.DURATION = 0.5
    rows = []
    for method in ("imex", "imex32", "implicit", "superelement", "superelement32"):
        for row in ensembles.run_setting(ensembles.Setting(method, STEPS.get(method, 2e-4), length=10.0, members=2)):
            rows.append(row | {"code": code_hash(ensembles.CODE, method)})
    pd.DataFrame(rows).to_csv(FOLDER / "ensembles.csv", index=False)
    insertions.END = insertions.START + insertions.STRETCH
    rows = []
    for method in ("imex", "imex32", "superelement", "superelement32", "newmark"):
        for row in insertions._insert(insertions.Insertion(method, STEPS.get(method, 2e-4), 20.0, members=2)):
            rows.append(row | {"code": code_hash(insertions.CODE, method)})
    pd.DataFrame(rows).to_csv(FOLDER / "insertions.csv", index=False)
    smooth.LEAST_TIMED = 1e-9
    rows = []
    case = smooth.cases()["contact"]
    for method in smooth.METHODS:
        step = min(case.time_steps, key=lambda dt: abs(dt - (1e-5 if method == "explicit" else 1e-4)))
        signal = np.zeros(1) if (solution := smooth.integrate(case, method, step)[0]) is None else solution
        code = code_hash(smooth.CODE, smooth.BASES.get(method, method))
        rows.append({"method": method, "signal": hashlib.sha1(signal.tobytes()).hexdigest(), "code": code})
    pd.DataFrame(rows).to_csv(FOLDER / "smooth.csv", index=False)


if __name__ == "__main__":
    main()
