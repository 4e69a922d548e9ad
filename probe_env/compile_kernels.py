"""Compile the kernels of every method ahead of their first run: ``python -m probe_env.compile_kernels``.

Without it the first run of a method takes some ten seconds longer; numba keeps what it compiled beside the sources.
"""

import sys

import numpy as np

from probe_env.envs.episodes.starts import WITHDRAWAL_SCENE
from probe_env.fidelity import ROUND_TRIP_PRESETS
from probe_env.physics.closed_forms import MEASURED, sliding_tension
from probe_env.physics.methods import METHODS
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.simulator import Simulator
from probe_env.scene import Scene


def compile_kernels() -> None:
    """Run a short scene with every method, and one of both passes with the method that they are simulated with."""
    for number, method in enumerate(METHODS.values(), start=1):
        print(f"kernels of {method.name} ({number} of {len(METHODS)})", file=sys.stderr)
        short = Scene(carrier_length=1.0)
        Simulator(short, method, method.usual_step).run(1e-3)
        if method.single_fraction < 1.0:  # then one probe has a kernel of its own
            SimulatorBatch([short] * method.width, method, method.usual_step).advance(duration=1e-3)
    sliding_tension(np.ones(1), dict.fromkeys(MEASURED, np.ones(1)), Scene().whole())
    compressed = Scene.model_validate({"carrier_length": 1.0} | WITHDRAWAL_SCENE)
    Simulator(compressed, ROUND_TRIP_PRESETS["standard"].simulated_method, 1e-4).run(1e-3)


if __name__ == "__main__":
    compile_kernels()
