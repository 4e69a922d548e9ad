"""What one change of the feed does to a probe that is drawn back: friction, length and how fast it is changed."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.records.provenance import provenance, write_atomically, write_json
from agents.terminal.tables import print_table
from probe_env.fidelity import BOTH_WAYS
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.scene import Scene

FRICTIONS: Final = (0.1, 0.15, 0.2, 0.25)
LENGTHS: Final = (30.0, 50.0)
"""Of the carrier cable [m]."""
RAMPS: Final = (0.5, 0.2, 0.1, 0.05)
"""How fast the feed is changed [m/s2]."""
FROM, TO = -0.2, -0.3
"""The change [m/s]."""
SETTLING: Final = 3.0
"""Before it [s]."""
HEARD: Final = 0.5
"""Over which an rms is taken [s]; the greatest until ``AFTER`` the change counts."""
AFTER: Final = 2.0
MEMBERS: Final = 4
"""Of each scene, with starts that differ by a tenth of a micrometre."""
HEADER: Final = ("friction", "cable [m]", *(f"{ramp:g} m/s2" for ramp in RAMPS))


def run_changes(output: Path) -> pd.DataFrame:
    """Simulate all, store and print; a row a scene, ramp and member: its greatest radial rms [m]."""
    fidelity, rows = BOTH_WAYS["fast"], []
    runs = list(product(FRICTIONS, LENGTHS, range(MEMBERS)))
    for ramp in tqdm(RAMPS, unit="ramp"):
        batch = SimulatorBatch(
            [scene_of(friction, length) for friction, length, _ in runs], fidelity.method, fidelity.time_step,
            fidelity.nodes_per_pitch, seeds=[member for *_, member in runs], ramp=ramp, start="outer",
            perturbation=1e-7,
        )  # fmt: skip
        batch.advance(None, None, SETTLING, SAMPLE_PERIOD)
        heard = round((abs(TO - FROM) / ramp + AFTER) / HEARD)
        rms = [batch.advance(TO, None, HEARD, SAMPLE_PERIOD, keep_samples=True).radial for _ in range(heard)]
        greatest = np.max([radial.std(axis=0) for radial in rms if radial is not None], axis=0)
        rows += [(*run, ramp, value) for run, value in zip(runs, greatest, strict=True)]
    table = pd.DataFrame(rows, columns=["friction", "carrier_length", "member", "ramp", "radial_rms_m"])
    write_atomically(output / "changes.csv", table.to_csv(index=False, float_format="%.5g"))
    write_json(output / "provenance.json", provenance() | {"fidelity": fidelity.model_dump()})
    title = f"Greatest radial rms [mm] after the feed goes from {-FROM:g} to {-TO:g} m/s on the way back"
    print_table(title, HEADER, cells(table), left=0)
    return table


def scene_of(friction: float, length: float) -> Scene:
    """Table 2's probe, drawn back at ``FROM`` by the study's air."""
    return Scene.model_validate({
        "feed_speed": FROM, "air_supply_rate": -63.0 / 3600.0, "couple": "tangent", "carrier_length": length,
        "contact": {"cable": True, "friction": friction},
    })  # fmt: skip


def cells(table: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a friction and length, a column a ramp: the mean over members [mm]."""
    mean = 1e3 * table.groupby(["friction", "carrier_length", "ramp"])["radial_rms_m"].mean()
    return [
        (f"{friction:g}", f"{length:g}", *(f"{mean[friction, length, ramp]:.2g}" for ramp in RAMPS))
        for friction, length in product(FRICTIONS, LENGTHS)
    ]
