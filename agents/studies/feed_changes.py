"""Vibration of a withdrawn probe after a change of the feed, by friction, length, helix and ramp."""

from __future__ import annotations

import math
from itertools import product
from typing import Final

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.records.atomic import write_atomically
from agents.records.manifest import write_manifest
from agents.studies.builtin import Request
from agents.terminal.tables import print_table
from probe_env.fidelity import BOTH_WAYS
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.scene import Scene

EXPONENTS: Final = (6.0, 9.0, 12.0, 15.0)
"""Of the capstan: friction times inserted length over the helix's radius."""
TUBES: Final = ((50.0, 1.2), (25.0, 1.2), (50.0, 1.7))
"""Carrier cable and helix diameter [m] of the scenes of each exponent; the friction follows."""
RAMPS: Final = (0.5, 0.2, 0.1, 0.05, 0.0)
"""How fast the feed is changed [m/s2]; 0: it is not, for comparison."""
FROM, TO = -0.2, -0.3
"""The change [m/s]."""
SETTLING: Final = 8.0
"""Before it [s]."""
SPAN: Final = 0.5
"""Over which an rms is taken [s]."""
AFTER: Final = 2.0
"""It is listened to from the change's begin until so long after its end [s]."""
MEMBERS: Final = 4
"""Of each scene, with starts that differ by a tenth of a micrometre."""
COLUMNS: Final = ("exponent", "friction", "carrier_length", "helix_diameter", "member", "ramp", "radial_rms_m")


def run(request: Request) -> pd.DataFrame:
    """Simulate, store and print; a row a scene, ramp and member with its greatest radial rms [m].

    Raises:
        RuntimeError: a simulation diverged.
    """
    request.without("limit", "trials", "tube")
    fidelity, rows = BOTH_WAYS["fast"], []
    runs = [(e, scene_of(e, *tube), member) for e, tube, member in product(EXPONENTS, TUBES, range(MEMBERS))]
    slowest = min(filter(None, RAMPS))
    for ramp in tqdm(RAMPS, unit="ramp"):
        batch = SimulatorBatch(
            [scene for _, scene, _ in runs], fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch,
            seeds=[member for *_, member in runs], ramp=ramp or RAMPS[0], start="outer", perturbation=1e-7,
        )  # fmt: skip
        batch.advance(None, None, SETTLING, SAMPLE_PERIOD)
        spans = math.ceil((abs(TO - FROM) / (ramp or slowest) + AFTER) / SPAN - 1e-9)
        windows = [batch.advance(TO if ramp else None, None, SPAN, SAMPLE_PERIOD) for _ in range(spans)]
        if diverged := int(windows[-1].diverged.sum()):
            raise RuntimeError(f"{diverged} of {len(runs)} simulations diverged at ramp = {ramp:g} m/s2")
        greatest = np.max([window.statistics["radial_rms_m"] for window in windows], axis=0)
        for (exponent, scene, member), value in zip(runs, greatest, strict=True):
            of_scene = (scene.contact.friction, scene.carrier_length, scene.tube.helix_diameter)
            rows.append((exponent, *of_scene, member, ramp, value))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    write_atomically(request.output / "changes.csv", table.to_csv(index=False, float_format="%.5g"))
    write_manifest(request.output, ("changes.csv",), fidelity=fidelity.model_dump())
    mean = 1e3 * table.groupby(["exponent", "ramp", "carrier_length", "helix_diameter"])["radial_rms_m"].mean()
    cells = []
    for exponent in EXPONENTS:
        ends = [(mean[exponent, ramp].min(), mean[exponent, ramp].max()) for ramp in RAMPS]
        cells.append((f"{exponent:g}", *(f"{low:.2g} to {high:.2g}" for low, high in ends)))
    title = f"Greatest radial rms [mm] after the feed goes from {-FROM:g} to {-TO:g} m/s on the way back"
    header = ("friction x length / radius", *(f"{ramp:g} m/s2" if ramp else "no change" for ramp in RAMPS))
    print_table(title, header, cells, left=0)
    return table


def scene_of(exponent: float, length: float, diameter: float) -> Scene:
    """Table 2's probe in a helix, drawn back at ``FROM`` by the study's air, with the friction of an exponent."""
    radius, inserted = diameter / 2.0, length + Scene().probe.guide_length
    return Scene.model_validate({
        "feed_speed": FROM, "air_supply_rate": -63.0 / 3600.0, "couple": "tangent", "carrier_length": length,
        "contact": {"cable": True, "friction": exponent * radius / inserted}, "tube": {"helix_diameter": diameter},
    })  # fmt: skip
