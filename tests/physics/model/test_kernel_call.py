"""No array that a caller gives makes a kernel write outside its own, and no chain is simulated in part."""

import numpy as np
import pytest

from probe_env import Scene, Simulator, SimulatorBatch
from probe_env.physics.methods import METHODS, SOLVERS
from probe_env.physics.model.chain import build_chain
from probe_env.physics.model.drive import APPEND, Drive
from probe_env.physics.model.kernel_call import Sampling
from probe_env.physics.model.state import State, at_rest

SCENE = Scene(carrier_length=1.0, probe={"guide_length": 0.5})
CHAIN = build_chain(SCENE)
NODES = CHAIN.node_count
STEPS = 4
KINDS = [(method, "ticm") for method in METHODS] + [("newmark", solver) for solver in list(SOLVERS)[1:]]


def step_of(method):
    """A time step [s] that holds."""
    return min(1e-4, METHODS[method].stable_step(SCENE, 4))


def call(**changes):
    """Arguments of an advance function that fit, with some of them changed."""
    arguments = {
        "inputs": Drive(0.2, 10.0).inputs_of_steps(STEPS, 1e-5, CHAIN.element_length, 0),
        "root": NODES - 1,
        "state": at_rest(NODES),
        "first": 2,
        "every": 2,
        "points": np.array([0, -1], dtype=np.int64),
        "samples": np.zeros((2, 2, 4)),
        "tension_sum": np.zeros(NODES),
        "counts": np.zeros(2, dtype=np.int64),
    } | changes
    sampling = Sampling(*(arguments[name] for name in Sampling._fields))
    return arguments["inputs"], arguments["root"], arguments["state"], sampling


def inputs(**columns):
    table = call()[0].copy()
    table[:, APPEND] = columns.get("append", 0.0)
    return table


READ_ONLY = np.zeros(NODES)
READ_ONLY.setflags(write=False)
REST = at_rest(NODES)
BAD = {
    r"state.d has shape \(3, 3\)": {"state": REST._replace(d=np.zeros((3, 3)))},
    rf"state.v has shape \({NODES + 2}, 3\)": {"state": REST._replace(v=np.zeros((NODES + 2, 3)))},
    rf"state.memory has shape \({NODES}, 2\)": {"state": REST._replace(memory=np.zeros((NODES, 2)))},
    "state.d has type float32": {"state": REST._replace(d=np.zeros((NODES, 3), dtype=np.float32))},
    "state.d is not contiguous": {"state": REST._replace(d=np.zeros((3, NODES)).T)},
    "state.d is a list": {"state": REST._replace(d=[[0.0] * 3] * NODES)},
    r"state.axial_force has shape \(1,\)": {"state": REST._replace(axial_force=np.zeros(1))},
    "state.axial_force is not contiguous and writable": {"state": REST._replace(axial_force=READ_ONLY)},
    "state is a tuple": {"state": tuple(REST)},
    f"root = {NODES} is outside": {"root": NODES},
    "root = 0 is outside": {"root": 0},
    r"inputs has shape \(4, 3\)": {"inputs": np.zeros((STEPS, 3))},
    f"inputs append 4 nodes to {NODES - 1}: the chain has room for 0": {"inputs": inputs(append=1.0)},
    "inputs: the last column": {"inputs": inputs(append=np.nan)},
    "inputs: the last column must be": {"inputs": inputs(append=7.0)},
    "first = 0": {"first": 0},
    "every = -1": {"every": -1},
    f"points: {NODES} is not a node": {"points": np.array([0, NODES])},
    "points: -2 is not a node": {"points": np.array([0, -2])},
    "points has type float64": {"points": np.array([0.0, -1.0])},
    "samples has 1 rows; 2 fall due in 4 steps": {"samples": np.zeros((1, 2, 4))},
    r"samples has shape \(2, 1, 4\)": {"samples": np.zeros((2, 1, 4))},
    r"samples has shape \(2, 2, 3\)": {"samples": np.zeros((2, 2, 3))},
    r"tension_sum has shape \(3,\)": {"tension_sum": np.zeros(3)},
    r"counts has shape \(1,\)": {"counts": np.zeros(1, dtype=np.int64)},
}


@pytest.fixture(scope="module")
def advances():
    return {(m, s): METHODS[m].build(CHAIN, step_of(m), 20, 4, SOLVERS[s]) for m, s in KINDS}


@pytest.mark.parametrize("message", BAD)
def test_arrays_that_do_not_fit_are_named_by_every_method(message, advances):
    for (method, _), advance in advances.items():
        bad = dict(BAD[message])
        memory = METHODS[method].memory
        if isinstance(bad.get("state", REST), State) and "memory" not in message:
            bad["state"] = bad.get("state", REST)._replace(memory=np.zeros((NODES, memory)))
        with pytest.raises(ValueError, match=message):
            advance(*call(**bad))


def test_arrays_that_fit_are_advanced_by_every_method(advances):
    for kind, advance in advances.items():
        if kind[1] == "transfer-matrix":
            continue  # loses its digits on so long a chain
        arguments = call(state=at_rest(NODES, METHODS[kind[0]].memory))
        status, steps, node, root = advance(*arguments)
        assert (status, steps, node, root) == (0, STEPS, -1, NODES - 1)
        assert (np.abs(arguments[3].samples[:, 1, 3]) > 0.0).all()  # drag pulls at the root


@pytest.mark.parametrize("method", METHODS)
def test_a_state_that_was_replaced_is_an_error_and_nothing_is_advanced(method):
    """It was a write beyond the array, which ended the interpreter."""
    step = step_of(method)
    simulator, batch = Simulator(SCENE, method, step), SimulatorBatch([SCENE, SCENE], method, step)
    simulator.state = simulator.state._replace(d=np.zeros((2, 3)))
    batch.simulators[1].state = batch.simulators[1].state._replace(v=np.zeros((2, 3)))
    for one, message in (
        (simulator, r"^state.d has shape \(2, 3\)"),
        (batch, r"^probe 1: state.v has shape \(2, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            one.advance(0.3, 0.03, 100 * step, 10 * step)
    for one in (simulator, *batch.simulators):
        assert one.steps_done == 0
        assert one.drive.feed_speed_target == SCENE.feed_speed
    batch.simulators[1].reset()
    batch.simulators[1].sensor = 10**6
    with pytest.raises(ValueError, match="probe 1: points: 1000000 is not a node"):
        batch.advance(duration=100 * step, sample_period=10 * step)
    batch.simulators[1].sensor, batch.simulators[1].root = 0, 10**6
    with pytest.raises(ValueError, match="probe 1: root = 1000000 is outside the accepted range 1 to 60"):
        batch.advance(duration=100 * step, sample_period=10 * step)


ONE = np.ones(NODES)
SPOT = np.where(np.arange(NODES) == 8, 1.0, 0.0)
UNKNOWN = {
    r"chain.load is not zero: {} does not simulate it": {"load": np.ones((NODES, 3))},
    r"chain.support_stiffness is not zero: {} does not simulate it": {"support_stiffness": np.eye(NODES, 3)},
    r"chain.contact_stiffness\[1\] = 1: {} simulates floats at every 4th node": {"contact_stiffness": ONE},
    r"chain.contact_stiffness\[8\] = 100001: ": {"contact_stiffness": CHAIN.contact_stiffness + SPOT},
    r"chain.drag\[8\] = ": {"drag": CHAIN.drag * (1.0 + SPOT)},
    r"chain.lever\[8\] = ": {"lever": CHAIN.lever * (1.0 + SPOT)},
    r"chain.outer_gap\[8\] = ": {"outer_gap": CHAIN.outer_gap * (1.0 + SPOT)},
}


@pytest.mark.parametrize("message", UNKNOWN)
@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.lanes])
def test_the_lanes_refuse_a_chain_that_they_would_simulate_in_part(message, method):
    chain = CHAIN._replace(**UNKNOWN[message])
    with pytest.raises(ValueError, match=message.format(method)):
        METHODS[method].build(chain, 1e-4, 20, 4)
    for other in ("newmark", "implicit"):
        METHODS[other].build(chain, 1e-4, 20, 4)


@pytest.mark.parametrize(
    ("changes", "sensor", "message"),
    [
        ({"drag": np.zeros(3), "lever": np.zeros(3)}, 0, r"chain.contact_stiffness has shape \(61,\); \(3\) is"),
        ({"load": np.zeros((NODES, 2))}, 0, "chain.load has shape"),
        ({}, NODES, "sensor = 61 is not a node from 0 to 60"),
        ({}, -1, "sensor = -1 is not"),
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_a_chain_whose_arrays_do_not_fit_each_other_is_refused(method, changes, sensor, message):
    with pytest.raises(ValueError, match=message):
        METHODS[method].build(CHAIN._replace(**changes), 1e-4, sensor, 4)
