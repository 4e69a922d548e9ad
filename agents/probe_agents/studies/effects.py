"""What parts of the whole model change and cost, alone and left out of the whole, and what further effects would."""

import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.records.manifest import write_manifest
from probe_agents.records.store import Store, write_tables
from probe_agents.studies.builtin import print_frame
from probe_agents.studies.chart import DURATION, PEAK, SETTLE, Run
from probe_agents.studies.claims import PERTURBATION
from probe_env import Scene, SimulatorBatch
from probe_env.fidelity import PRESETS
from probe_env.physics.closed_forms import steady_root_tension
from probe_env.physics.simulation.signals import SAMPLE_PERIOD, dominant_frequencies

PARTS: Final[dict[str, dict[str, Any]]] = {
    "weight": {"contact": {"weight": True}},
    "air": {"air": {"compressible": True}},
    "shortening": {"terms": {"shortening": True}, "couple": "tangent"},
    "stiction": {"terms": {"stiction": True}},
    "entrance": {"terms": {"entrance": True}},
}
"""Changes of a scene of the study."""
ALONE: Final = {"study": (), **{part: (part,) for part in PARTS}, "whole": tuple(PARTS)}
EFFECTS: Final[dict[str, dict[str, Any]]] = {
    "restitution 0.9": {"contact": {"damping": 2.2}},  # c = 2 z sqrt(k m), z = -ln e / sqrt(pi^2 + ln^2 e)
    "restitution 0.7": {"contact": {"damping": 7.5}},
    "friction slope -0.1": {"contact": {"friction_slope": -0.1}},
    "friction slope 0.1": {"contact": {"friction_slope": 0.1}},
    **{f"feed ripple {ripple}": {"feed_ripple": ripple} for ripple in (0.002, 0.005, 0.01)},
}
"""Further effects, off by default: low and high ends of plausible ranges, as changes of the whole model."""
CHANGES: Final = PARTS | EFFECTS
LEFT_OUT: Final = {f"whole without {part}": tuple(other for other in PARTS if other != part) for part in PARTS}
FURTHER: Final = {name: ALONE[name] for name in ("study", "whole")} | {
    f"whole with {effect}": (*PARTS, effect) for effect in EFFECTS
}
MODELS: Final = ALONE | LEFT_OUT | FURTHER
"""Name of a model -> its parts."""
FRICTIONS, AIRS = (0.1, 0.175, 0.25), (40.0, 63.0, 120.0)  # [-], [m3/h]
FURTHER_FRICTIONS: Final = (0.1, 0.125, 0.15, 0.175)
"""Friction of ``FURTHER``."""
LENGTHS: Final = (5.0, 7.5, 10.0, 12.5, 15.0, 20.0, 30.0, 40.0, 50.0)
"""Carrier lengths [m]."""
ONSET: Final = 2e-5
"""Radial rms [m]."""


@dataclass(frozen=True)
class Effect(Run):
    """Table 2's probe at constant length, at ``standard``."""

    friction: float
    length: float
    """Carrier length [m]."""
    model: str
    members: int

    def scene(self, air: float = 63.0) -> Scene:
        """The scene at an air supply [m3/h]."""
        contact, rate = {"friction": self.friction}, air / 3600.0
        scene = Scene.model_validate({"carrier_length": self.length, "contact": contact, "air_supply_rate": rate})
        for part in MODELS[self.model]:
            scene = scene.model_copy(update=CHANGES[part])
        return scene

    def rows(self) -> list[dict[str, Any]]:
        """One row per member; ``cpu_s`` is the processor time of a simulated second."""
        numerics, scenes = PRESETS["standard"].numerics, [self.scene()] * self.members
        batch = SimulatorBatch(scenes, *numerics, threads=1, perturbation=PERTURBATION)
        batch.advance(duration=SETTLE)
        begin = time.process_time()
        window = batch.advance(duration=DURATION, keep_samples=True)
        cpu = (time.process_time() - begin) / DURATION / self.members
        assert window.axial is not None
        peaks = [dominant_frequencies(signal, SAMPLE_PERIOD, 1) for signal in window.axial.T]
        table = pd.DataFrame({name: window.statistics[name] for name in ("radial_rms_m", "tension_mean_n")})
        table[PEAK] = [peak[0] if peak else np.nan for peak in peaks]
        table.loc[window.diverged] = np.nan
        table = table.assign(diverged=window.diverged, cpu_s=cpu, **self.key)
        return table.rename_axis("member").reset_index().to_dict("records")  # type: ignore[return-value]


def run(output: Path, trials: int = 16, workers: Workers = HERE) -> pd.DataFrame:
    """Run what is not stored, with ``trials`` members; writes members.csv, effects.csv, onset.csv, root-tension.csv."""
    keys = *product(FRICTIONS, LENGTHS, ALONE | LEFT_OUT), *product(FURTHER_FRICTIONS, LENGTHS, FURTHER)
    runs = [Effect(*key, members=trials) for key in keys]
    store = Store(output / "members.csv", (*runs[0].key, "member"))
    members = store.fill({effect.last: effect for effect in runs}, Effect.rows, "setting")
    tables = {"effects": effects(members), "onset": onsets(members), "root-tension": root_tensions()}
    write_manifest(output, ["members.csv", *write_tables(output, tables, 4)], commits=members["commit"], members=trials)
    for name, table in tables.items():
        print_frame(name, table, texts=0)
    return tables["effects"]


def effects(members: pd.DataFrame) -> pd.DataFrame:
    """Means and standard errors over the members that did not diverge, and ratios to the study's model."""
    names, keys = ["radial_rms_m", "tension_mean_n", PEAK, "cpu_s"], ["friction", "carrier_length_m", "model"]
    groups = members.groupby(keys, sort=False)
    table = groups[names].mean().join(groups[names[:3]].sem().add_suffix(":error")).join(groups["diverged"].sum())
    base = table.xs("study", level="model")[names]
    return table.join((table[names] / base).add_suffix(":ratio")).reset_index()


def onsets(members: pd.DataFrame) -> pd.DataFrame:
    """Carrier length [m] at which the radial rms reaches ``ONSET``, by friction and model: mean and standard error.

    The logarithm is interpolated between lengths. Members that stay below are not counted.
    """
    table = members.pivot_table("radial_rms_m", ["friction", "model", "member"], "carrier_length_m", sort=False)
    rms = np.log(np.maximum.accumulate(table.to_numpy(), axis=1))
    lengths = [np.interp(np.log(ONSET), row, table.columns, left=np.nan, right=np.nan) for row in rms]
    groups = pd.Series(lengths, table.index).groupby(["friction", "model"], sort=False)
    return groups.agg(onset_m="mean", error_m="sem", members="count").reset_index()


def root_tensions() -> pd.DataFrame:
    """Closed form of the root tension over that of the study's model, by air supply, friction and length."""
    lengths, names = (0.5, *LENGTHS, 57.5), ("air_m3_per_h", "friction", "carrier_length_m")
    cases = pd.MultiIndex.from_product((AIRS, FRICTIONS, lengths), names=names)
    tensions = [[steady_root_tension(Effect(mu, x, model, 1).scene(air)) for model in ALONE] for air, mu, x in cases]
    table = pd.DataFrame(tensions, cases, list(ALONE))
    return table.div(table["study"], axis=0).reset_index()
