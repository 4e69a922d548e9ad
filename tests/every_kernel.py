"""Short runs that reach every branch of every kernel; with NUMBA_BOUNDSCHECK=1 an index out of bounds is an error.

A script, because the flag must stand before numba is imported, and must not mix with kernels compiled without it.
"""

import itertools

import numpy as np

from probe_env import Scene, Simulator, SimulatorBatch
from probe_env.physics.methods import METHODS

STEPS = {name: method.usual_step for name, method in METHODS.items()}
LANES = [name for name, method in METHODS.items() if method.width > 1]


def scene(walls, guide=0.3, carrier=0.5):
    """A short probe in a narrow tube; growing it meets the helix's end, where no node is appended any more."""
    return Scene(
        tube={"helix_length": guide + carrier + 0.05, "inner_diameter": 0.01902},
        probe={"guide_length": guide}, carrier_length=carrier,
        contact={"walls": walls, "stiffness": 1e4, "friction": 0.3},
    )  # fmt: skip


def thrown(simulator):
    """Onto both walls in turn."""
    d = simulator.state.d[: simulator.root, 1]
    d += 1e-5 - 2e-5 * np.cos(np.pi * np.arange(len(d)) / 8)


def run_all():
    """Number of runs."""
    runs = 0
    for (method, step), walls, growing in itertools.product(STEPS.items(), ("both", "inner"), (False, True)):
        simulator = Simulator(scene(walls), method, step, growing=growing, time_lapse=1000.0 if growing else 1.0)
        thrown(simulator)
        simulator.advance(0.25, 0.03, 90 * step, 9 * step, ("sensor", "tip", "root", 0.2))
        assert simulator.root == simulator.chain.node_count - 1  # to the helix's end
        runs += 1
    for (method, step), cable in itertools.product(STEPS.items(), (False, True)):
        if not METHODS[method].simulates_withdrawal:
            continue
        back = {"feed_speed": -1.5, "air_supply_rate": -0.03, "couple": "tangent", "contact": {"cable": cable}}
        simulator = Simulator(
            scene("both").model_copy(update=back), method, step, growing=True, time_lapse=1000.0, start="outer"
        )
        thrown(simulator)
        simulator.advance(None, None, 90 * step, 9 * step, ("sensor", "tip", "root"))
        assert simulator.root == simulator.sensor + simulator.nodes_per_pitch  # as far as it goes
        simulator.advance(0.25, 0.03, 90 * step, 9 * step)  # and in again
        runs += 1
    for method, count in itertools.product(STEPS, (1, 5)):
        if METHODS[method].simulates_weight:
            terms = {"shortening": count > 1, "stiction": count > 1}
            contact = {"weight": True, "damping": 0.1 if METHODS[method].simulates_damping else 0.0}
            options = {"contact": contact, "air": {"compressible": True}, "terms": terms}
            scenes = [scene("both").model_copy(update=options)] * count
            batch = SimulatorBatch(scenes, method, STEPS[method], growing=True, time_lapse=1000.0, threads=1)
            for simulator in batch.simulators:
                thrown(simulator)
            batch.advance(0.25, 0.03, 90 * STEPS[method], 9 * STEPS[method])
            runs += 1
    for method, count in itertools.product(LANES, range(1, 10)):
        scenes = [scene(("both", "inner")[k % 2], 0.1 * (k % 3), 0.3 + 0.1 * k) for k in range(count)]
        batch = SimulatorBatch(scenes, method, STEPS[method], growing=True, time_lapse=100.0, threads=1)
        for simulator in batch.simulators:
            thrown(simulator)
        batch.advance(0.25, 0.03, 40 * STEPS[method], 4 * STEPS[method])
        batch.advance(0.25, 0.03, 3 * STEPS[method], STEPS[method], np.arange(count) % 2 == 0)
        runs += 1
    return runs


if __name__ == "__main__":
    print(run_all())
