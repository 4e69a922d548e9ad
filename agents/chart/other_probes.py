"""Other probes than table 2's: the usual mesh and step beside the converged one, for random designs in random tubes.

Which modes a superelement keeps follows from the probe and its contact by a frequency criterion
(``probe_env.physics.methods.superelement.contact``), so nothing is chosen by hand. A row is a member, as in
``ensembles``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.chart.ensembles import CONVERGED_NODES, CONVERGED_STEP, DURATION, SETTLE, member_statistics
from agents.chart.errors import FLOORS
from agents.records.code_hash import code_hash
from agents.records.shipped import shipped_folder
from agents.records.store import Store
from agents.rollouts.bootstrap import Interval
from agents.rollouts.statistics import ratio_interval
from agents.study.cases import PERTURBATION
from agents.terminal.work import Work, announce
from probe_env import Design, Scene, SimulatorBatch
from probe_env.envs.contexts import draw_context
from probe_env.fidelity import PRESETS, Fidelity
from probe_env.physics.simulation.signals import SAMPLE_PERIOD

CODE: Final = ("agents.chart.other_probes:run_probe",)
KEYS: Final = ("probe", "method", "time_step_s", "nodes_per_pitch", "member")
INSERTED: Final = 40.0  # [m]
RANDOM: Final = 10
SEED: Final = 19
CONVERGED: Final = Fidelity(method="imex32", time_step=CONVERGED_STEP, nodes_per_pitch=CONVERGED_NODES)
QUARTER: Final = PRESETS["standard"].model_copy(update={"time_step": 0.25 * PRESETS["standard"].time_step})
FIDELITIES: Final = {
    "standard": PRESETS["standard"], "standard-v0": PRESETS["standard-v0"], "a quarter of the step": QUARTER,
    "converged": CONVERGED,
}  # fmt: skip
"""What is compared, and with which: the last."""
MEMBERS: Final = {"standard": 32, "standard-v0": 32, "a quarter of the step": 32, "converged": 16}
SHOWN: Final = {
    "radial_rms_m": "radial rms", "radial_p99_m": "radial p99", "radial_acceleration_rms_m_per_s2": "acceleration",
    "lift_off_share": "lift-off", "axial_rms_m": "axial rms",
}  # fmt: skip


@dataclass(frozen=True)
class OtherProbe:
    """A probe in a tube, ``INSERTED`` deep."""

    name: str
    scene: Scene


@cache
def other_probes() -> tuple[OtherProbe, ...]:
    """The improved probe in table 2's tube and ten drawn from the design space in tubes drawn as contexts are."""
    improved = Design.from_toml(shipped_folder("design") / "improved.toml")
    drawn = []
    for number in range(RANDOM):
        rng = np.random.default_rng([SEED, number])
        drawn.append(OtherProbe(f"design {number}", draw_context(rng).apply(_inserted(Design.random(rng)))))
    return (OtherProbe("improved", _inserted(improved)), *drawn)


def _inserted(design: Design) -> Scene:
    """A design at the nearest whole number of pitches to ``INSERTED``."""
    probe = design.probe()
    pitches = round((INSERTED - probe.guide_length) / probe.float_pitch)
    return Scene(probe=probe, carrier_length=round(pitches * probe.float_pitch, 6))


def run_probe(scene: Scene, fidelity: Fidelity, members: int) -> list[dict[str, Any]]:
    """A row a member: its statistics, none where it diverged."""
    batch = SimulatorBatch(
        [scene] * members, fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch, perturbation=PERTURBATION
    )
    batch.advance(None, None, SETTLE, SAMPLE_PERIOD)
    window = batch.advance(None, None, DURATION, SAMPLE_PERIOD, keep_samples=True)
    return [
        {"member": member, "diverged": bool(window.diverged[member])}
        | ({} if window.diverged[member] else member_statistics(window, member))
        for member in range(members)
    ]


def run_other_probes(output: Path, limit: int = 0) -> pd.DataFrame:
    """What is not stored yet; a row a member in other-probes.csv.

    Args:
        output: folder of the table.
        limit: the first so many probes; 0: all.
    """
    store = Store(output / "other-probes.csv", KEYS, lambda row: code_hash(CODE, row["method"]))
    wanted = [(probe, name) for probe in other_probes()[: limit or None] for name in FIDELITIES]

    def stored(pair: tuple[OtherProbe, str]) -> bool:
        return store.has(*_key(pair[0], FIDELITIES[pair[1]]), MEMBERS[pair[1]] - 1)

    todo = [pair for pair in wanted if not stored(pair)]
    announce(Work("setting", len(wanted), lambda: sum(map(stored, wanted)), store.path))
    for probe, name in tqdm(todo, desc="other probes", unit="setting", disable=not todo):
        fidelity = FIDELITIES[name]
        key = dict(zip(KEYS, _key(probe, fidelity), strict=False))
        store.add(*(key | row for row in run_probe(probe.scene, fidelity, MEMBERS[name])))
    return store.table


def _key(probe: OtherProbe, fidelity: Fidelity) -> tuple[Any, ...]:
    return probe.name, fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch


def ratios(table: pd.DataFrame, name: str) -> dict[str, dict[str, Interval]]:
    """Probe -> statistic -> ratio of a fidelity's mean to the converged mesh's, with its 95 % interval.

    A statistic that is too small to matter (``errors.FLOORS``) is compared with what matters: both sides get the rest.
    """
    compared: dict[str, dict[str, Interval]] = {}
    for probe in other_probes():
        part, base = (_members(table, probe, FIDELITIES[fidelity]) for fidelity in (name, "converged"))
        if len(part) and len(base):
            compared[probe.name] = {
                statistic: _ratio(part[statistic], base[statistic], statistic) for statistic in SHOWN
            }
    return compared


def _members(table: pd.DataFrame, probe: OtherProbe, fidelity: Fidelity) -> pd.DataFrame:
    key = dict(zip(KEYS, _key(probe, fidelity), strict=False))
    chosen = (table[list(key)] == list(key.values())).all(axis=1) & ~table["diverged"].astype(bool)
    return table[chosen]


def _ratio(values: pd.Series, reference: pd.Series, statistic: str) -> Interval:
    rest = max(FLOORS[statistic] - abs(float(reference.mean())), 0.0)
    return ratio_interval(values.to_numpy(dtype=float) + rest, reference.to_numpy(dtype=float) + rest)


def markdown(table: pd.DataFrame) -> str:
    """A row a probe: what it is, and the ratios of ``standard``; below it what they come to over the probes."""
    heads = ["probe", "what it is", "radial rms [mm]", *SHOWN.values(), "radial rms, a quarter of the step"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    usual, finer = (ratios(table, name) for name in ("standard", "a quarter of the step"))
    for probe in other_probes():
        if probe.name in usual:
            reference = _members(table, probe, CONVERGED)["radial_rms_m"].mean()
            shown = [*usual[probe.name].values(), finer[probe.name]["radial_rms_m"]]
            cells = [f"{i.mean:.2f} [{i.low:.2f}, {i.high:.2f}]" for i in shown]
            lines.append(
                f"| {probe.name} | {_words(probe.scene)} | {1e3 * reference:.3f} | " + " | ".join(cells) + " |"
            )
    return "\n".join(lines) + "\n\n" + "\n".join(f"* {sentence}" for sentence in sentences(table))


def sentences(table: pd.DataFrame) -> list[str]:
    """Over the probes that ring, the geometric mean of every statistic's ratio, a fidelity a line; who diverged."""
    lines = []
    for name in list(FIDELITIES)[:-1]:
        ringing = {probe: values for probe, values in ratios(table, name).items() if _rings(table, probe)}
        means = [
            f"{words} {np.exp(np.mean([np.log(values[statistic].mean) for values in ringing.values()])):.2f}"
            for statistic, words in SHOWN.items()
        ]
        called = f"`{name}`" if name in PRESETS else f"`standard` at {name}"
        lines.append(
            f"{called}, geometric mean over the {len(ringing)} that ring (0.01 mm and more): {', '.join(means)}."
        )
    lost = table[table["diverged"].astype(bool)].groupby("probe").size()
    counts = ", ".join(f"{count} of {probe}" for probe, count in lost.items()) or "none"
    return [*lines, f"Of {len(table)} runs diverged: {counts}."]


def _rings(table: pd.DataFrame, name: str) -> bool:
    probe = next(probe for probe in other_probes() if probe.name == name)
    return float(_members(table, probe, CONVERGED)["radial_rms_m"].mean()) >= FLOORS["radial_rms_m"]


def _words(scene: Scene) -> str:
    probe = scene.probe
    return (
        f"guide {probe.guide_length:.1f} m, floats {1e3 * probe.guide_float_diameter:.1f} and"
        f" {1e3 * probe.carrier_float_diameter:.1f} mm every {1e3 * probe.float_pitch:.0f} mm, EI"
        f" {probe.flexural_rigidity:.3f} N m²; {scene.tube.helix_diameter:g} m, friction {scene.contact.friction:.2f}"
    )
