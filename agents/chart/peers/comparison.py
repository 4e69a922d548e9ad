"""The same cantilever in this project, PyElastica, MuJoCo and Exudyn, in one process: error against cost.

The packages are optional (``make peers``); one that is missing gives a row that says so. The error against the bar is
that of mesh and step together, the error in time is against what the package's own mesh does in continuous time.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from tqdm import tqdm

from agents.chart.peers import models
from agents.records.drawing import GRID, save
from agents.records.provenance import provenance, write_atomically, write_json
from probe_env.arrays import FloatArray

RAN, TIMED = "ran", "timed only"
LEAST_REPEATS, REPEAT_S = 3, 2.0
"""Repeats after the whole run, cut to some seconds of processor time; the fastest counts."""


@dataclass(frozen=True)
class Peer:
    """A package: how it runs the scene, what its mesh does, how far the two can be compared.

    ``settings`` are (method, elements, time step [s]); ``ends`` is what the bar that the mesh stands for is longer by,
    in elements.
    """

    module: str
    marker: str
    run: Callable[[str, int, float, int], models.Recorded]
    exact: Callable[[str, int], FloatArray]
    ends: float
    settings: tuple[tuple[str, int, float], ...]
    comparable: str
    remarks: str


ALPHA: Final = "GeneralizedAlpha"
STIFF, SOFT = models.SHEAR_RIGIDITY
PEERS: Final[dict[str, Peer]] = {
    "probe-env": Peer(
        "probe_env", "o", models.run_ours, models.exact_ours, 0.5,
        (
            ("newmark", 40, 1e-4), ("newmark", 40, 1e-2), ("newmark", 40, 1e-1), ("imex", 40, 2e-4),
            ("imex", 40, 1e-2), ("imex", 40, 1e-1), ("implicit", 40, 2e-4), ("implicit", 40, 1e-2),
            ("explicit", 40, 1e-5), ("explicit", 40, 2.5e-5), ("explicit", 40, 3.125e-5),
        ),
        "planar, linear",
        "linear, planar beam elements between lumped masses; a whole mass at the tip is half an element of bar more."
        " Curved rest shape, contact, friction and growing length: all four, they are what it is for. `implicit` damps"
        " a smooth motion at long steps on purpose; `imex` and `explicit` fill one of their four lanes here.",
    ),
    "PyElastica": Peer(
        "elastica", "s", models.run_elastica, models.exact_elastica, -0.5,
        ((STIFF, 40, 5e-6), (SOFT, 40, 2.5e-5), (SOFT, 20, 4e-5), (SOFT, 40, 3.125e-5)),
        "same mesh; 3D, shear, large turns",
        "Cosserat rod with explicit position Verlet, the nearest to `explicit`: same masses, but in three dimensions,"
        " with shear, twist and large rotations, so it does more work a step, most of it calls from Python at this"
        " size. Its clamp holds the whole first element, so the bar is half an element shorter. Curved rest shape:"
        " yes. Contact: with planes, cylinders, spheres and rods, from outside; the inside of a tube would have to be"
        " written. Friction: on planes. Growing length: no.",
    ),
    "MuJoCo": Peer(
        "mujoco", "^", models.run_mujoco, models.exact_mujoco, 0.0,
        (
            ("euler", 40, 2.5e-4), ("euler", 20, 1e-3), ("rk4", 40, 2.5e-4), ("discrete", 40, 1e-3),
            ("discrete", 40, 1e-2), ("euler", 40, 5e-4),
        ),
        "cannot stretch; no axial waves",
        "rigid links with springs in the hinges: it cannot stretch, so no axial wave limits the step, and none is"
        " there: what carries drive and friction along the real probe is missing. Without damping `implicitfast` is"
        " `euler` (semi-implicit); `discrete` is implicit and damps. A step of a serial chain grows with more than the"
        " square of its links (400 links: 10 m), and beyond 1,024 it cannot be built. Curved rest shape: yes, the"
        " angle of every hinge's spring. Contact and Coulomb friction: yes, soft constraints solved within the step, a"
        " tube put together from convex pieces. Growing length: no, the model would be compiled anew.",
    ),
    "Exudyn": Peer(
        "exudyn", "D", models.run_exudyn, models.exact_exudyn, 0.0,
        ((ALPHA, 4, 1e-3), (ALPHA, 8, 1e-3), (ALPHA, 8, 1e-2), (ALPHA, 8, 1e-1), (ALPHA, 40, 1e-2)),
        "cubic elements, large turns",
        "ANCF cable elements, planar, with large rotations, and generalized-alpha with a spectral radius of 1, the"
        " trapezoidal rule as in `newmark`; a Newton iteration a step. Cubic elements of consistent mass need a fifth"
        " of the nodes here; a float every 100 mm would take that away. Its Newton tolerance is loosened from 1e-8 to"
        " 1e-6: with the default small steps fail. Curved rest shape: yes. Contact and friction: yes, penalty, of"
        " circles with the cable. Growing length: no, but a cable that moves through a mesh of constant length.",
    ),
}  # fmt: skip
LONG_CHAINS: Final = (400, 2400)
"""Links of 25 mm that MuJoCo is asked for: 10 m, and the 60 m of the probe."""
DISTRIBUTIONS: Final = {"PyElastica": "pyelastica", "MuJoCo": "mujoco", "Exudyn": "exudyn"}


def run_peers(output: Path) -> pd.DataFrame:
    """Rows of package, method, elements and time_step_s, written to peers.csv with peers-provenance.json.

    ``status`` is "ran", "timed only" or why there are no figures. ``error`` is the largest of the tip over the run
    against the bar, ``error_ends`` against a bar that is ``ends`` elements longer, ``time_error`` against the package's
    own mesh, all over the amplitude; ``period_error``, ``period_error_ends`` and ``amplitude_loss`` (over the run) are
    those of a fitted decaying cosine; ``cpu_s`` is for a simulated second.
    """
    jobs: list[tuple[str, Callable[[], dict[str, Any]], tuple[str, int, float]]] = []
    for name, peer in PEERS.items():
        jobs += [(name, lambda p=peer, s=setting: _row(p, *s), setting) for setting in peer.settings]  # type: ignore[misc]
    jobs += [("MuJoCo", lambda n=n: _long_chain(n), ("euler", n, 2.5e-4)) for n in LONG_CHAINS]  # type: ignore[misc]
    rows = []
    for name, job, (method, elements, time_step) in tqdm(jobs, desc="peers", unit="setting"):
        setting = {"package": name, "method": method, "elements": elements, "time_step_s": time_step}
        try:
            import_module(PEERS[name].module)
        except (ImportError, OSError) as reason:
            rows.append({**setting, "status": f"not installed: {reason}"})
            continue
        try:
            result = job()
        except Exception as reason:  # whatever a package raises is its answer
            text = " ".join(str(reason).split())
            result = {"status": text if isinstance(reason, models.UnstableError) else f"fails: {text}"}
        rows.append({**setting, **result})
    table = pd.DataFrame(rows, columns=[*setting, "status", *_FIGURES])
    buffer = io.StringIO()
    table.to_csv(buffer, index=False, float_format="%.4g")
    write_atomically(output / "peers.csv", buffer.getvalue())
    origin = provenance(f"probe-env peers --output {output}")
    write_json(output / "peers-provenance.json", {**origin, "packages": {**origin["packages"], **_versions()}})
    return table


_FIGURES: Final = (
    "error", "error_ends", "period_error", "period_error_ends", "amplitude_loss", "time_error", "cpu_s", "steps_per_s",
    "ns_per_node_step",
)  # fmt: skip


def _versions() -> dict[str, str]:
    result = {}
    for name in DISTRIBUTIONS.values():
        try:
            result[name] = version(name)
        except PackageNotFoundError:
            result[name] = "not installed"
    return result


def _row(peer: Peer, method: str, elements: int, time_step: float) -> dict[str, Any]:
    peer.run(method, elements, time_step, 1)  # compiled and warm
    signal, spent = peer.run(method, elements, time_step, models.SAMPLES)
    samples = int(np.clip(models.SAMPLES * REPEAT_S / spent, 1, models.SAMPLES))
    rates = [spent / models.SAMPLES]
    rates += [peer.run(method, elements, time_step, samples)[1] / samples for _ in range(LEAST_REPEATS)]
    times, tip = models.sample_times(), signal / models.AMPLITUDE
    omega = models.frequency()

    def off(p: FloatArray) -> FloatArray:
        return np.asarray(p[0] * np.exp(-p[2] * times) * np.cos(p[1] * times) - tip)

    _, fitted, decay = least_squares(off, (1.0, omega, 0.0)).x
    ends = models.frequency(models.LENGTH * (1.0 + peer.ends / elements))
    return {
        "status": RAN,
        "error": np.abs(tip - np.cos(omega * times)).max(),
        "error_ends": np.abs(tip - np.cos(ends * times)).max(),
        "period_error": omega / fitted - 1.0,
        "period_error_ends": ends / fitted - 1.0,
        "amplitude_loss": -np.expm1(-decay * times[-1]),
        "time_error": np.abs(tip - peer.exact(method, elements) / models.AMPLITUDE).max(),
        **_cost(min(rates) / models.SAMPLE_PERIOD, elements, time_step),
    }


def _cost(cpu: float, elements: int, time_step: float) -> dict[str, float]:
    return {
        "cpu_s": cpu,
        "steps_per_s": 1.0 / time_step,
        "ns_per_node_step": 1e9 * cpu * time_step / (elements + 1),
    }


def _long_chain(elements: int, time_step: float = 2.5e-4, steps: int = 100) -> dict[str, Any]:
    """Cost of a step of MuJoCo at another length, elements of 25 mm; the motion is of no interest."""
    mujoco: Any = import_module("mujoco")
    model = models.mujoco_model(mujoco, "euler", elements, time_step, 0.025 * elements)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    spent = []
    for _ in range(LEAST_REPEATS):
        begin = time.process_time()
        mujoco.mj_step(model, data, nstep=steps)
        spent.append(time.process_time() - begin)
    return {"status": TIMED, **_cost(min(spent) / steps / time_step, elements, time_step)}


def markdown(table: pd.DataFrame) -> str:
    """A row a setting, then what each package is and which of the real scene's parts it offers."""
    heads = (
        "package", "method", "elements", "step [s]", "error against the bar [%]",
        "against a bar of its own length [%]", "period against the bar [%]", "against a bar of its own length [%]",
        "amplitude lost [%]", "error in time [%]", "CPU s a simulated s", "ns a node-step", "how comparable",
    )  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for row in table.to_dict("records"):
        cells = [row["package"], row["method"], f"{row['elements']}", f"{row['time_step_s']:g}", *_figures(row)]
        lines.append("| " + " | ".join(cells) + f" | {PEERS[row['package']].comparable} |")
    lines += ["", *(f"* {name}: {peer.remarks}" for name, peer in PEERS.items())]
    return "\n".join(lines)


def _figures(row: Mapping[Any, Any]) -> list[str]:
    cost = [f"{row['cpu_s']:.2g}", f"{row['ns_per_node_step']:.3g}"]
    if row["status"] == RAN:
        shares = (row[name] for name in _FIGURES[:6])
        return [*(f"{100.0 * share if abs(share) > 1e-9 else 0.0:.2g}" for share in shares), *cost]
    if row["status"] == TIMED:
        return [TIMED, *["-"] * 5, *cost]
    return [row["status"], *["-"] * 7]


def draw(table: pd.DataFrame, path: Path) -> Path:
    """Error over processor time of a simulated second; numbers are elements, on the right time steps."""
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.6), sharex=True, sharey=True, layout="constrained")
    ran = table[table["status"] == RAN]
    colours = plt.get_cmap("tab10").colors  # type: ignore[attr-defined]
    titles = {
        "error": "against the bar",
        "error_ends": "against a bar of its own length: mesh and step",
        "time_error": "against its own mesh: step alone",
    }
    for axis, (column, title) in zip(axes, titles.items(), strict=True):
        series = ran.groupby(["package", "method"], sort=False)
        for number, ((package, method), rows) in enumerate(series):
            marker, colour = PEERS[str(package)].marker, colours[number % len(colours)]
            axis.plot(rows["cpu_s"], rows[column], marker, color=colour, label=f"{package}, {method}", alpha=0.8)
            for x, y, elements, step in rows[["cpu_s", column, "elements", "time_step_s"]].itertuples(index=False):
                text = f"{step:.2g} s" if column == "time_error" else f"{elements}"
                axis.annotate(text, (x, y), (4, 4), textcoords="offset points", fontsize=6, color="0.4")
        axis.set(xlabel="CPU seconds for a simulated second", xscale="log", yscale="log", title=title)
        axis.grid(**GRID)
    axes[0].set_ylabel("largest error of the tip / amplitude")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=8)
    save(figure, path, dpi=110)
    return path
