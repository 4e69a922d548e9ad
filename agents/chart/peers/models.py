"""One scene in four packages: a straight cantilever of table 2's cable, let go in the shape of its first mode.

Every ``run_*`` builds the scene, steps it for a number of samples and returns the tip's deflection (k,) [m] every
``SAMPLE_PERIOD`` and the processor time of the steps alone; it raises where the scene does not hold. Every ``exact_*``
is what the mesh of the same package does in continuous time: its small motion from the same start, mode by mode, so
that the error of the time integration can be told from that of the mesh. Other packages are imported when they run.
"""

from __future__ import annotations

import math
import os
import time
from importlib import import_module
from itertools import pairwise
from typing import Any, Final

import numpy as np

from agents.chart import smooth
from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms.bare_chains import RADIAL, Driven, linear_matrix, masses, plain_chain
from probe_env.physics.model.chain import Chain

LENGTH, LINE_DENSITY, EI, EA, DIAMETER = 1.0, 0.111, 4.8e-2, 1.1e5, 8.35e-3
AMPLITUDE: Final = 1e-3
"""Of the tip [m]; small enough for linear theory, of which large deflections depart by its square."""
SAMPLE_PERIOD, SAMPLES = 0.1, 82
"""82 samples: three periods of 2.7 s."""
BETA_L: Final = 1.8751040687119611
SHEAR_RIGIDITY: Final = {"shear EA/3": EA / 3.0, "shear 1 kN": 1e3}
"""Of PyElastica's rod [N]; 1 kN lowers the first frequency by 1e-4 and leaves the step to the axial waves."""
Recorded = tuple[FloatArray, float]


class UnstableError(Exception):
    """A run that left the linear range or reported an unstable simulation."""


def frequency(length: float = LENGTH) -> float:
    """First natural frequency of the Euler-Bernoulli cantilever [rad/s]."""
    return (BETA_L / length) ** 2 * math.sqrt(EI / LINE_DENSITY)


def mode(place: FloatArray, length: float = LENGTH) -> tuple[FloatArray, FloatArray]:
    """Deflection [m] and slope of the first mode at a distance from the clamp, ``AMPLITUDE`` at the tip."""
    s = BETA_L / length * place
    ratio = (math.cosh(BETA_L) + math.cos(BETA_L)) / (math.sinh(BETA_L) + math.sin(BETA_L))
    y = np.cosh(s) - np.cos(s) - ratio * (np.sinh(s) - np.sin(s))
    slope = np.sinh(s) + np.sin(s) - ratio * (np.cosh(s) - np.cos(s))
    return 0.5 * AMPLITUDE * y, 0.5 * AMPLITUDE * BETA_L / length * slope


def sample_times() -> FloatArray:
    """Times of the samples (k,) [s]."""
    return SAMPLE_PERIOD * np.arange(1, SAMPLES + 1)


def _free_motion(M: FloatArray, K: FloatArray, start: FloatArray, tip: FloatArray) -> FloatArray:
    """``tip`` of the undamped motion from rest at ``start``, at the sample times."""
    factor = np.linalg.inv(np.linalg.cholesky(M))
    squares, modes = np.linalg.eigh(factor @ K @ factor.T)
    weights = (tip @ factor.T @ modes) * (modes.T @ np.linalg.solve(factor.T, start))
    return np.asarray(np.cos(np.outer(sample_times(), np.sqrt(squares))) @ weights)


def _checked(signal: list[float]) -> FloatArray:
    values = np.array(signal)
    if not (np.isfinite(values).all() and np.abs(values).max() < 10.0 * AMPLITUDE):
        raise UnstableError("diverges")
    return values


# ours: whole masses at the nodes, the tip included


def _our_start(elements: int) -> tuple[Chain, FloatArray, FloatArray]:
    """Chain, displacements (n, 3) at rest, M^-1 K of the free nodes (3 n, 3 n)."""
    chain = plain_chain(elements, damping_time=0.0)
    d = np.zeros((elements, 3))
    place = chain.element_length * np.arange(elements, 0.0, -1.0)
    d[:, 1], d[:, 2] = mode(place, place[0])
    # axial motion decouples here and would stay exactly zero beyond the step that it allows: a trace of it
    d[:, 0] = 1e-9 * place / place[0]
    return chain, d, linear_matrix(chain)


def run_ours(method: str, elements: int, time_step: float, samples: int) -> Recorded:
    """Elements of 25 mm on the kernel of a method, begun with the acceleration that the shape asks for."""
    chain, d, linear = _our_start(elements)
    a = -(linear @ d.ravel()).reshape(d.shape)
    case = smooth.Case(
        "cantilever", Driven(chain), samples * SAMPLE_PERIOD, SAMPLE_PERIOD, (0, RADIAL), None, d=d, a=a
    )  # fmt: skip
    signal, cpu, _ = smooth.integrate(case, method, time_step)
    if signal is None:
        raise UnstableError("diverges")
    return _checked(list(signal)), cpu * case.duration


def exact_ours(method: str, elements: int) -> FloatArray:
    """The chain's own modes."""
    chain, d, linear = _our_start(elements)
    mass = masses(chain)
    return _free_motion(np.diag(mass), mass[:, None] * linear, d.ravel(), np.eye(3 * elements)[1])


# PyElastica: a Cosserat rod, whose clamp holds the direction of the whole first element


def _elastica_start(elements: int) -> tuple[FloatArray, FloatArray]:
    """Deflections (n + 1,) and directions (n,) without shear: the mode of a bar clamped half an element further in."""
    h = LENGTH / elements
    _, angle = mode(h * np.arange(elements), LENGTH - 0.5 * h)
    y = np.concatenate([[0.0], np.cumsum(h * np.sin(angle))])
    return y, angle


def run_elastica(method: str, elements: int, time_step: float, samples: int) -> Recorded:
    """Position Verlet; ``method`` names the shear rigidity."""
    ea: Any = import_module("elastica")
    area = math.pi * DIAMETER**2 / 4.0
    rod = ea.CosseratRod.straight_rod(
        elements, np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), LENGTH, DIAMETER / 2.0,
        LINE_DENSITY / area, youngs_modulus=EA / area, shear_modulus=EA / area / 3.0,
    )  # fmt: skip
    for k in (0, 1):  # a cable is far softer in bending than a solid section
        rod.bend_matrix[k, k] = EI
        rod.shear_matrix[k, k] = SHEAR_RIGIDITY[method]
    system = type("System", (ea.BaseSystemCollection, ea.Constraints), {})()
    system.append(rod)
    system.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    system.finalize()
    y, angle = _elastica_start(elements)
    rod.position_collection[0, 1:] = np.cumsum(LENGTH / elements * np.cos(angle))
    rod.position_collection[1] = y
    for k, (c, s) in enumerate(zip(np.cos(angle), np.sin(angle), strict=True)):
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rod.director_collection[..., k] = rod.director_collection[..., k] @ turn.T
    stepper, now, signal = ea.PositionVerlet(), 0.0, []
    begin = time.process_time()
    for _ in range(samples):
        for _ in range(round(SAMPLE_PERIOD / time_step)):
            now = stepper.step(system, now, time_step)
        signal.append(float(rod.position_collection[1, -1]))
    return _checked(signal), time.process_time() - begin


def exact_elastica(method: str, elements: int) -> FloatArray:
    """Half a mass at the tip, shear springs in the elements, bending springs at the inner nodes."""
    n, h = elements, LENGTH / elements
    y, angle = _elastica_start(n)
    shear = np.zeros((n, 2 * n))  # of (y_1 .. y_n, phi_0 .. phi_n-1)
    shear[:, :n] = (np.eye(n) - np.eye(n, k=-1)) / h
    shear[:, n:] = -np.eye(n)
    bend = np.zeros((n - 1, 2 * n))
    bend[:, n:] = np.diff(np.eye(n), axis=0)
    K = SHEAR_RIGIDITY[method] * h * shear.T @ shear + EI / h * bend.T @ bend
    mass = np.full(2 * n, LINE_DENSITY * h)
    mass[n - 1] *= 0.5
    mass[n:] *= DIAMETER**2 / 16.0
    free = np.delete(np.arange(2 * n), n)
    start, tip = np.concatenate([y[1:], angle]), np.eye(2 * n)[n - 1]
    return _free_motion(np.diag(mass)[np.ix_(free, free)], K[np.ix_(free, free)], start[free], tip[free])


# MuJoCo: rigid links with springs in the hinges, which cannot stretch


def mujoco_model(mujoco: Any, integrator: str, elements: int, time_step: float, length: float = LENGTH) -> Any:
    """A serial chain of ``elements`` bodies; half an element bends at the clamp, hence the double stiffness there."""
    h = length / elements
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = time_step, [0.0, 0.0, 0.0]
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    mass = LINE_DENSITY * h
    body = spec.worldbody
    for k in range(elements):
        body = body.add_body(pos=[h if k else 0.0, 0.0, 0.0])
        body.explicitinertial, body.mass, body.ipos = True, mass, [h / 2.0, 0.0, 0.0]
        body.inertia = [mass * (h**2 / 12.0 + DIAMETER**2 / 16.0)] * 3
        hinge = mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(type=hinge, axis=[0.0, 0.0, 1.0], stiffness=(1.0 if k else 2.0) * EI / h)
    return spec.compile()


def run_mujoco(method: str, elements: int, time_step: float, samples: int) -> Recorded:
    """``method`` is the integrator."""
    mujoco: Any = import_module("mujoco")
    mujoco.set_mju_user_warning(lambda _: None)  # or it leaves a log file in the working directory
    model = mujoco_model(mujoco, method, elements, time_step)
    data, h, signal = mujoco.MjData(model), LENGTH / elements, []
    y, _ = mode(h * np.arange(elements + 1))
    data.qpos[:] = np.diff(np.arcsin(np.diff(y) / h), prepend=0.0)
    steps = round(SAMPLE_PERIOD / time_step)
    begin = time.process_time()
    for _ in range(samples):
        mujoco.mj_step(model, data, nstep=steps)
        signal.append(float(data.xpos[-1, 1] + h * data.xmat[-1, 3]))
    spent = time.process_time() - begin
    if np.any(data.warning.number):  # it starts anew where an acceleration overflows
        raise UnstableError("diverges")
    return _checked(signal), spent


def exact_mujoco(method: str, elements: int) -> FloatArray:
    """Links of their own inertia by their angles to the bar; the tip is the sum of them."""
    n, h = elements, LENGTH / elements
    y, _ = mode(h * np.arange(n + 1))
    centres = h * (np.tri(n, k=-1) + 0.5 * np.eye(n))
    M = LINE_DENSITY * h * (centres.T @ centres + (h**2 / 12.0 + DIAMETER**2 / 16.0) * np.eye(n))
    bend = np.eye(n) - np.eye(n, k=-1)
    K = bend.T @ np.diag([2.0, *[1.0] * (n - 1)]) @ bend * EI / h
    return _free_motion(M, K, np.diff(y) / h, np.full(n, h))


# Exudyn: ANCF cable elements, cubic in deflection


def run_exudyn(method: str, elements: int, time_step: float, samples: int) -> Recorded:
    """``method`` is a ``DynamicSolverType``; generalized-alpha without numerical damping."""
    os.environ.setdefault("EXUDYN_MODULE", "fast")  # without range checks
    exu: Any = import_module("exudyn")
    item: Any = import_module("exudyn.itemInterface")
    container = exu.SystemContainer()
    system = container.AddSystem()
    x = np.linspace(0.0, LENGTH, elements + 1)
    fine = np.linspace(0.0, LENGTH, 64 * elements + 1)
    shorter = np.concatenate([[0.0], np.cumsum(np.diff(fine) * (1.0 - np.cos(mode(fine[:-1])[1])))])[::64]
    y, slope = mode(x)
    nodes = [
        system.AddNode(item.NodePoint2DSlope1(referenceCoordinates=[x[k], 0.0, 1.0, 0.0], initialCoordinates=list(q)))
        for k, q in enumerate(np.column_stack([-shorter, y, np.cos(slope) - 1.0, np.sin(slope)]))
    ]
    for pair in pairwise(nodes):
        system.AddObject(item.ObjectANCFCable2D(
            length=LENGTH / elements, massPerLength=LINE_DENSITY, bendingStiffness=EI, axialStiffness=EA,
            nodeNumbers=list(pair),
        ))  # fmt: skip
    wall = system.AddNode(item.NodePointGround())
    ground = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=wall, coordinate=0))
    for k in (0, 1, 3):
        held = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=k))
        system.AddObject(item.ObjectConnectorCoordinate(markerNumbers=[ground, held]))
    quantity = exu.OutputVariableType.Displacement
    tip = system.AddSensor(
        item.SensorNode(nodeNumber=nodes[-1], outputVariableType=quantity, storeInternal=True, writeToFile=False)
    )
    system.Assemble()
    settings, duration = exu.SimulationSettings(), samples * SAMPLE_PERIOD
    settings.timeIntegration.endTime = duration
    settings.timeIntegration.numberOfSteps = round(duration / time_step)
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    # the axial stiffness rounds at its default of 1e-8, which no small step reaches
    settings.timeIntegration.newton.relativeTolerance = 1e-6
    settings.timeIntegration.newton.absoluteTolerance = 1e-9
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = SAMPLE_PERIOD
    if elements > 10:
        settings.linearSolverType = exu.LinearSolverType.EigenSparse
    exu.SetWriteToConsole(False)
    begin = time.process_time()
    try:
        system.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, method))
    finally:
        spent = time.process_time() - begin
        exu.SetWriteToConsole(True)
    return _checked([float(row[2]) for row in system.GetSensorStoredData(tip)[1:]]), spent


def exact_exudyn(method: str, elements: int) -> FloatArray:
    """Hermite beam elements with their consistent mass, which the cable is for small deflections."""
    h, size = LENGTH / elements, 2 * elements + 2
    M, K = np.zeros((size, size)), np.zeros((size, size))
    corner, cross = np.array([[156.0, 22.0], [22.0, 4.0]]), np.array([[54.0, -13.0], [13.0, -3.0]])
    flip = np.diag([1.0, -1.0])
    mass = np.block([[corner, cross], [cross.T, flip @ corner @ flip]]) * LINE_DENSITY * h / 420.0
    corner, cross = np.array([[12.0, 6.0], [6.0, 4.0]]), np.array([[-12.0, 6.0], [-6.0, 2.0]])
    stiffness = np.block([[corner, cross], [cross.T, flip @ corner @ flip]]) * EI / h**3
    scale = np.tile([1.0, h], 2)
    for k in range(elements):
        part = slice(2 * k, 2 * k + 4)
        M[part, part] += scale[:, None] * mass * scale
        K[part, part] += scale[:, None] * stiffness * scale
    start = np.column_stack(mode(np.linspace(0.0, LENGTH, elements + 1))).ravel()
    return _free_motion(M[2:, 2:], K[2:, 2:], start[2:], np.eye(size)[size - 2, 2:])
