"""Feed control and probe design: a fast simulator of a long cable in a helical tube.

Scenes, designs and actions enter; runs, observations, rewards and KPIs leave. Imports no room
of ``probe_agents`` and no library of agents.

>>> from probe_env import Scene, Simulator
>>> run = Simulator(Scene(carrier_length=10.0)).run(duration=0.5)
>>> run.radial.shape
(501, 2)
"""

from importlib.metadata import PackageNotFoundError, version

import gymnasium

from probe_env.kernel_cache import ensure_kernel_cache

ensure_kernel_cache()  # before anything imports a kernel

from probe_env.design import Design
from probe_env.envs.contexts import Context, load_contexts, spread_contexts
from probe_env.envs.plants import Plant
from probe_env.envs.task.config import TaskConfig
from probe_env.errors import SimulationError, StabilityWarning
from probe_env.fidelity import Fidelity, FidelityChoice, choose_fidelity, resolve_fidelity
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.run import Run
from probe_env.physics.simulation.simulator import Simulator
from probe_env.physics.simulation.window import Window
from probe_env.scene import Air, Contact, Probe, Scene, Terms, Tube
from probe_env.schedule import Schedule
from probe_env.settings import Model

__all__ = [
    "Air", "Contact", "Context", "Design", "Fidelity", "FidelityChoice", "Model", "Plant", "Probe", "Run", "Scene",
    "Schedule", "SimulationError", "Simulator", "SimulatorBatch", "StabilityWarning", "TaskConfig", "Terms", "Tube",
    "Window", "__version__", "choose_fidelity", "load_contexts", "resolve_fidelity", "spread_contexts",
]  # fmt: skip

try:
    __version__ = version("probe-env")
except PackageNotFoundError:  # sources on the path that nobody has installed
    __version__ = "unknown"

# no max_episode_steps: the time limit depends on the arguments; an environment writes it into its own spec
for _name in ("Insertion-v1", "IncrementalInsertion-v1", "Snapshot-v1", "Inspection-v0"):
    _class = _name.split("-")[0]
    gymnasium.register(
        id=f"probe_env/{_name}",
        entry_point=f"probe_env.envs.env:{_class}Env",
        vector_entry_point=f"probe_env.envs.env:{_class}VectorEnv",
    )
gymnasium.register(id="probe_env/Design-v1", entry_point="probe_env.envs.design_env:DesignEnv")
