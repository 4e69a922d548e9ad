"""Feed control and probe design: a fast simulator of a long cable in a helical tube.

>>> from probe_env import Scene, Simulator
>>> run = Simulator(Scene(carrier_length=10.0)).run(duration=0.5)
>>> run.radial.shape
(501, 2)
"""

from probe_env.batch import SimulatorBatch, Window
from probe_env.errors import SimulationError, StabilityWarning
from probe_env.run import Run
from probe_env.scene import Air, Contact, Probe, Scene, Tube
from probe_env.simulator import Simulator

__all__ = [
    "Air",
    "Contact",
    "Probe",
    "Run",
    "Scene",
    "SimulationError",
    "Simulator",
    "SimulatorBatch",
    "StabilityWarning",
    "Tube",
    "Window",
]
