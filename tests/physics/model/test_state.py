"""States and chains that a kernel does not support are errors; kernels do not check bounds."""

import numpy as np
import pytest

from probe_env import Scene, Simulator, SimulatorBatch
from probe_env.physics.methods import METHODS
from probe_env.physics.model.chain import build_chain
from probe_env.physics.model.state import at_rest

SCENE = Scene(carrier_length=1.0, probe={"guide_length": 0.5})
CHAIN = build_chain(SCENE)
NODES = CHAIN.node_count
READ_ONLY = np.zeros(NODES)
READ_ONLY.setflags(write=False)
BAD = {
    r"state.d has shape \(3, 3\)": {"d": np.zeros((3, 3))},
    rf"state.v has shape \({NODES + 2}, 3\)": {"v": np.zeros((NODES + 2, 3))},
    rf"state.memory has shape \({NODES}, 2\)": {"memory": np.zeros((NODES, 2))},
    "state.d has type float32": {"d": np.zeros((NODES, 3), dtype=np.float32)},
    "state.d is not contiguous": {"d": np.zeros((3, NODES)).T},
    "state.d is a list": {"d": [[0.0] * 3] * NODES},
    r"state.axial_force has shape \(1,\)": {"axial_force": np.zeros(1)},
    "state.axial_force is not contiguous and writable": {"axial_force": READ_ONLY},
}


@pytest.mark.parametrize("method", METHODS)
def test_an_invalid_state_is_an_error_and_nothing_is_advanced(method):
    """It was a write beyond the array, which ended the interpreter."""
    step = min(1e-4, METHODS[method].stable_step(SCENE, 4))
    simulator, batch = Simulator(SCENE, method, step), SimulatorBatch([SCENE, SCENE], method, step)
    second, rest = batch.simulators[1], at_rest(NODES, METHODS[method].memory)

    def refused(message):
        for one, text in ((simulator, f"^{message}"), (batch, f"^probe 1: {message}")):
            with pytest.raises(ValueError, match=text):
                one.advance(0.3, 0.03, 100 * step, 10 * step)

    for message, changes in BAD.items():
        simulator.state = second.state = rest._replace(**changes)
        refused(message)
    simulator.state = second.state = tuple(rest)
    refused("state is a tuple")
    simulator.state = second.state = rest
    for root in (0, NODES, 10**6):
        simulator.root = second.root = root
        refused(f"root = {root} is outside the accepted range 1 to {NODES - 1}")
    simulator.root = second.root = NODES - 1
    for sensor in (-2, 10**6):
        simulator.sensor = second.sensor = sensor
        refused(f"points: {sensor} is not a node")
    for one in (simulator, *batch.simulators):
        assert one.steps_done == 0
        assert one.drive.feed_speed_target == SCENE.feed_speed
        assert not one.state.d.any()


SPOT = np.where(np.arange(NODES) == 8, 1.0, 0.0)
UNKNOWN = {
    r"chain.load is not zero: {} does not simulate it": {"load": np.ones((NODES, 3))},
    r"chain.support_stiffness is not zero: {} does not simulate it": {"support_stiffness": np.eye(NODES, 3)},
    r"chain.contact_stiffness\[1\] = 1: {} simulates floats at every 4th node": {"contact_stiffness": np.ones(NODES)},
    r"chain.contact_stiffness\[8\] = 100001: ": {"contact_stiffness": CHAIN.contact_stiffness + SPOT},
    r"chain.drag\[8\] = ": {"drag": CHAIN.drag * (1.0 + SPOT)},
    r"chain.lever\[8\] = ": {"lever": CHAIN.lever * (1.0 + SPOT)},
    r"chain.outer_gap\[8\] = ": {"outer_gap": CHAIN.outer_gap * (1.0 + SPOT)},
}


@pytest.mark.parametrize("method", METHODS)
def test_lane_methods_refuse_unsupported_chains(method):
    for message, changes in UNKNOWN.items():
        chain = CHAIN._replace(**changes)
        if METHODS[method].width == 1 or ("drag" in changes and METHODS[method].simulates_expansion):
            METHODS[method].constants(chain, 20, 4, 1e-4)
            continue
        with pytest.raises(ValueError, match=message.format(method)):
            METHODS[method].constants(chain, 20, 4, 1e-4)
