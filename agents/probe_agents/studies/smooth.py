"""Error against cost before chaos: linear chains, an impact, and contact.

The error is the maximum error of one displacement over its maximum value. The cost is processor time of one thread per
simulated second, and the number of sweeps over the chain, which does not depend on the machine.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import pandas as pd
from scipy.stats import linregress

from probe_agents.records.store import Store
from probe_env import Scene
from probe_env.arrays import FloatArray
from probe_env.physics import closed_forms, methods
from probe_env.physics.closed_forms.bare_chains import (
    AXIAL,
    RADIAL,
    DrivenChain,
    bent_chain,
    run_chain,
    uniform_chain,
)
from probe_env.physics.methods.newmark import Newmark
from probe_env.physics.model.chain import air_speed, build_chain, sensor_node
from probe_env.physics.model.state import State, at_rest

LONG = (5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6)  # [s]
REFERENCES = (("imex", 1e-7), ("explicit", 1e-7))
"""Methods and steps [s] for the scene without a closed form."""
SMOOTH_KEYS = ("scene", "method", "time_step_s")
COLUMNS = (*SMOOTH_KEYS, "error", "cpu_s", "sweeps")
REFERENCE_ROWS = "references"
"""Value of the column ``method`` for the difference of the two references."""
MIN_TIMED = 0.2  # [s] of processor time, repeats included
RESOLVED = 10.0  # errors below this multiple of the references' difference are not evaluated
ROUNDING = 1e-8  # errors below it are rounding


@dataclass(frozen=True)
class Case:
    """A scene before chaos.

    Attributes:
        duration, sample_period: [s].
        point: observed node and component.
        exact: function from times to the observed displacement; None: two references.
        d, v, a: initial values; a of None: zero, as in the study.
    """

    title: str
    driven: DrivenChain
    duration: float
    sample_period: float
    point: tuple[int, int]
    exact: Callable[[FloatArray], FloatArray] | None
    time_steps: tuple[float, ...] = LONG
    d: FloatArray | None = None
    v: FloatArray | None = None
    a: FloatArray | None = None

    def start(self, method: str, time_step: float) -> State:
        """State at t = 0; velocities of ``explicit`` are those half a step earlier."""
        state = at_rest(self.driven.chain.node_count)
        for target, values in zip((state.d, state.v, state.memory[:, :3]), (self.d, self.v, self.a), strict=True):
            if values is not None:
                target[:-1] = values
        if method == "explicit":
            state.v[:] -= 0.5 * time_step * state.memory[:, :3]
        if not isinstance(methods.METHODS[method], Newmark):
            state.memory[:] = 0.0  # not an acceleration there
        return state


def _linear(consistent: bool) -> Case:
    """Half a metre of cable with the curvature of the helix, released from a smooth shape."""
    elements = 20
    chain = bent_chain(elements)
    position = np.linspace(1.0, 0.0, elements + 1)[:-1, None]
    load = np.zeros((elements, 3))
    load[:, 1:2] = 1e-3 * np.sin(0.5 * np.pi * position) ** 4
    shape = closed_forms.linear_chain(chain, np.zeros(1), load, 0.0 * load)[0]
    a = -load / np.array([chain.mass, chain.mass, chain.inertia])  # balances the load

    def exact(times: FloatArray) -> FloatArray:
        return closed_forms.linear_chain(chain, times, load, 0.0 * load)[:, 0, RADIAL]

    title = f"linear chain, {'smooth' if consistent else 'printed'} start"
    return Case(title, DrivenChain(chain), 0.05, 1e-3, (0, RADIAL), exact, d=shape, a=a if consistent else None)


def _step_load() -> Case:
    """Five metres of cable with a constant force on all floats from t = 0 (drag of a very fast air flow)."""
    elements, force, wind = 200, 0.01, 1e6
    nodes = np.arange(elements + 1)
    chain = uniform_chain(elements, drag=np.where(nodes % 4 == 0, force / wind**2, 0.0))
    load = np.zeros((elements, 3))
    load[::4, AXIAL] = force

    def exact(times: FloatArray) -> FloatArray:
        return closed_forms.linear_chain(chain, times, 0.0 * load, load)[:, 0, AXIAL]

    return Case("axial step load", DrivenChain(chain, air_speed=wind), 0.05, 1e-3, (0, AXIAL), exact)


def _impact() -> Case:
    """A mass of one node that hits the wall's spring from 0.1 mm at 0.1 m/s."""
    stiffness, height, speed = 1e5, 1e-4, 0.1
    free = dict.fromkeys(("axial_compliance", "shear_compliance", "bending_compliance"), 1e6)
    chain = uniform_chain(1, contact_stiffness=np.array([stiffness, 0.0]), coupling_compliance=0.0, **free)

    def exact(times: FloatArray) -> FloatArray:
        return closed_forms.impact(chain.mass, stiffness, height, speed, times)

    steps = (4e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)
    d, v = np.array([[0.0, height, 0.0]]), np.array([[0.0, -speed, 0.0]])
    return Case("impact on the wall's spring", DrivenChain(chain), 4e-3, 4e-4, (0, RADIAL), exact, steps, d, v)


def _contact() -> Case:
    """The study's scene at l = 10 m, the first 0.2 s."""
    scene = Scene(carrier_length=10.0)
    sensor = sensor_node(scene, 4)
    driven = DrivenChain(build_chain(scene), sensor, scene.feed_speed, air_speed(scene, scene.air_supply_rate))
    return Case("contact and friction, l = 10 m", driven, 0.2, 1e-3, (sensor, AXIAL), None)


@lru_cache
def cases() -> dict[str, Case]:
    """The scenes by name."""
    linear = {"linear": _linear(consistent=True), "linear-printed": _linear(consistent=False)}
    return linear | {"step-load": _step_load(), "impact": _impact(), "contact": _contact()}


def integrate(case: Case, method: str, time_step: float) -> tuple[FloatArray | None, float, float]:
    """Observed displacement (k,) [m] (None: diverged), processor time [s] and sweeps per simulated second.

    The run is repeated for ``MIN_TIMED`` of processor time; the minimum is returned.
    """
    steps, every = round(case.duration / time_step), round(case.sample_period / time_step)
    used, fastest = 0.0, float("inf")
    while used < MIN_TIMED:
        start = case.start(method, time_step)
        run = run_chain(method, case.driven, time_step, start, steps, every, case.point[0])
        if not run.stable:
            return None, float("nan"), float("nan")
        used, fastest = used + run.cpu, min(fastest, run.cpu)
    return run.samples[:, case.point[1]], fastest / case.duration, run.sweeps / case.duration


def run_smooth(store: Store) -> pd.DataFrame:
    """Rows of scene, method, time_step_s, error (NaN: diverged), cpu_s and sweeps per simulated second.

    The scene without a closed form has a row ``REFERENCE_ROWS``. Stored rows are not run again.
    """
    cells = [
        (name, method, dt) for name, case in cases().items() for method in methods.ON_NODES for dt in case.time_steps
    ]
    truth: dict[str, FloatArray] = {}

    def rows_of(cell: tuple[str, str, float]) -> list[dict[str, object]]:
        (name, method, time_step), case = cell, cases()[cell[0]]
        if name not in truth:
            truth[name] = _truth(case, store)
        integrate(case, method, case.time_steps[0])  # warm-up
        signal, cpu, sweeps = integrate(case, method, time_step)
        error = float("nan") if signal is None else _difference(signal, truth[name])
        return [dict(zip(COLUMNS, (name, method, time_step, error, cpu, sweeps), strict=True))]

    return store.fill({cell: cell for cell in cells}, rows_of)


def _truth(case: Case, store: Store) -> FloatArray:
    if case.exact is not None:
        count = round(case.duration / case.sample_period)
        return case.exact(case.sample_period * np.arange(1, count + 1))
    first, second = (integrate(case, method, dt)[0] for method, dt in REFERENCES)
    assert first is not None
    assert second is not None
    store.add({"scene": "contact", "method": REFERENCE_ROWS, "time_step_s": 0.0, "error": _difference(second, first)})
    return first


def _difference(signal: FloatArray, truth: FloatArray) -> float:
    return float(np.abs(signal - truth).max() / np.abs(truth).max())


def resolved(table: pd.DataFrame, scene: str) -> pd.DataFrame:
    """Rows of a scene with an error well above the difference of its references, diverged runs included."""
    rows = table[table["scene"] == scene]
    difference = rows.loc[rows["method"] == REFERENCE_ROWS, "error"]
    minimum = RESOLVED * float(difference.iloc[0]) if len(difference) else 0.0
    of_methods = rows[rows["method"] != REFERENCE_ROWS]
    return of_methods[of_methods["error"].isna() | (of_methods["error"] >= minimum)]


def orders(table: pd.DataFrame) -> pd.DataFrame:
    """Order of every method in every scene, fitted to the finest steps, with the error at the finest step.

    Columns scene, method, order, error, time_step_s. The order is NaN with fewer than three resolved steps, and for
    methods whose rounding grows for small steps: these have the smallest error and its step.
    """
    rows = []
    for scene, method in product(cases(), methods.ON_NODES):
        part, order = resolved(table, scene), float("nan")
        part = part[(part["method"] == method) & part["error"].notna()].sort_values("time_step_s")
        if methods.METHODS[method].min_step > 0.0:
            part = part.nsmallest(1, "error")
        else:
            part = part[part["error"] > ROUNDING].head(4)
            if len(part) >= 3:
                order = linregress(np.log(part["time_step_s"]), np.log(part["error"])).slope
        if len(part):
            rows.append((scene, method, order, part["error"].iloc[0], part["time_step_s"].iloc[0]))
    return pd.DataFrame(rows, columns=["scene", "method", "order", "error", "time_step_s"])
