"""Compile the kernels of every method ahead of their first run: ``python -m probe_env.compile_kernels``.

Without it the first run of a method takes some ten seconds longer; numba keeps what it compiled beside the sources.
"""

from __future__ import annotations

import sys
from typing import Final

from probe_env.physics.simulator import Simulator
from probe_env.scene import Scene

TIME_STEPS: Final = {"imex": 2e-4, "imex32": 2e-4, "newmark": 1e-4, "explicit": 5e-6, "implicit": 1e-4}
"""Method -> a step [s] that holds; ``wilson`` runs through the kernel of ``newmark``."""


def compile_kernels() -> None:
    """Run a short scene with every method."""
    for number, (method, time_step) in enumerate(TIME_STEPS.items(), start=1):
        print(f"kernels of {method} ({number} of {len(TIME_STEPS)})", file=sys.stderr)
        Simulator(Scene(carrier_length=1.0), method, time_step).run(1e-3)


if __name__ == "__main__":
    compile_kernels()
