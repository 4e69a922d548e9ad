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

WINDINGS: Final = (6.0, 9.0, 12.0, 15.0)
"""Friction times inserted length over the helix's radius, the exponent of the capstan: so many are simulated."""
TUBES: Final = ((50.0, 1.2), (25.0, 1.2), (50.0, 2.4))
"""Carrier cable and helix diameter [m] of the scenes of each, whose frictions follow."""
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
COLUMNS: Final = ("winding", "friction", "carrier_length", "helix_diameter", "member", "ramp", "radial_rms_m")
HEADER: Final = ("friction x length / radius", *(f"{ramp:g} m/s2" for ramp in RAMPS))


def run_changes(output: Path) -> pd.DataFrame:
    """Simulate all, store and print; a row a scene, ramp and member: its greatest radial rms [m]."""
    fidelity, rows = BOTH_WAYS["fast"], []
    runs = [(winding, scene_of(winding, *tube), m) for winding, tube, m in product(WINDINGS, TUBES, range(MEMBERS))]
    for ramp in tqdm(RAMPS, unit="ramp"):
        batch = SimulatorBatch(
            [scene for _, scene, _ in runs], fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch,
            seeds=[member for *_, member in runs], ramp=ramp, start="outer", perturbation=1e-7,
        )  # fmt: skip
        batch.advance(None, None, SETTLING, SAMPLE_PERIOD)
        heard = round((abs(TO - FROM) / ramp + AFTER) / HEARD)
        rms = [batch.advance(TO, None, HEARD, SAMPLE_PERIOD).statistics["radial_rms_m"] for _ in range(heard)]
        for (winding, scene, member), value in zip(runs, np.max(rms, axis=0), strict=True):
            of_scene = (scene.contact.friction, scene.carrier_length, scene.tube.helix_diameter)
            rows.append((winding, *of_scene, member, ramp, value))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    write_atomically(output / "changes.csv", table.to_csv(index=False, float_format="%.5g"))
    write_json(output / "provenance.json", provenance() | {"fidelity": fidelity.model_dump()})
    title = f"Greatest radial rms [mm] after the feed goes from {-FROM:g} to {-TO:g} m/s on the way back"
    print_table(title, HEADER, cells(table), left=0)
    return table


def scene_of(winding: float, length: float, diameter: float) -> Scene:
    """Table 2's probe in a helix, drawn back at ``FROM`` by the study's air, with the friction of a winding."""
    radius, inserted = diameter / 2.0, length + Scene().probe.guide_length
    return Scene.model_validate({
        "feed_speed": FROM, "air_supply_rate": -63.0 / 3600.0, "couple": "tangent", "carrier_length": length,
        "contact": {"cable": True, "friction": winding * radius / inserted}, "tube": {"helix_diameter": diameter},
    })  # fmt: skip


def cells(table: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a winding, a column a ramp: the least and the greatest of its tubes, means over members [mm]."""
    mean = 1e3 * table.groupby(["winding", "ramp", "carrier_length", "helix_diameter"])["radial_rms_m"].mean()
    rows = []
    for winding in table["winding"].unique():
        ends = [(mean[winding, ramp].min(), mean[winding, ramp].max()) for ramp in RAMPS]
        rows.append((f"{winding:g}", *(f"{low:.2g} to {high:.2g}" for low, high in ends)))
    return rows
