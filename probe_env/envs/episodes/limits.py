"""Limits of time step and model, checked before an episode begins.

Two limits are of the time step: contact needs omega dt <= 1.8 (stability.py), and superelements treat the tension along
the cable explicitly, so that high drag needs a short step. Three are of the model, at any step:

* the wall must be stiffer than pi^4 EI / (4 p^3). A beam on a foundation of k / p buckles at 2 sqrt(EI k / p), between
  two floats at pi^2 EI / p^2: below, the cable leaves through the wall before it buckles between floats;
* steady drag must not press a float deeper into the wall than the tube has clearance;
* rotations are small: the tip of a probe that drag stretches and presses into the wall slides s along the helix and
  so turns by s / r, which the couple V l theta of (9) takes for a slope: waves that run to the tip gain energy from
  it. Beyond 1 rad sin and cos are off by 16 and 46 %. A probe that starts at rest is not held by friction until it
  has sunk in, so that the start is bounded without it.
"""

import math
from typing import Final, NamedTuple

from probe_env.envs.task.config import TaskConfig
from probe_env.fidelity import MESH_NODES, Fidelity
from probe_env.physics.closed_forms import buckling_load, steady_tensions
from probe_env.physics.methods import METHODS, check_scene
from probe_env.physics.methods.method import Method
from probe_env.physics.model.chain import air_speed
from probe_env.scene import Probe, Scene, whole_pitches
from probe_env.settings import whole_steps

MAX_TURN: Final = 1.0  # [rad]
REMEDY: Final = "use a stiffer contact, less drag or a wider helix"
SHORTEST_STEP: Final = 1e-7  # [s], of a fidelity
PULL_LIMIT: Final = 0.0125
"""Of T dt^2 / (rho p^2), T the tension of steady sliding: 20 insertions of table 2's probe in straight tubes, with 2 to
10 times the drag, diverged at 2e-4 s from 0.0148 on (411 to 549 N)."""
START_LIMIT: Final = 1.9
"""[m/s], of T dt / (rho p), T what drag pulls a probe with that starts at rest, before friction holds it: the wave that
runs through it then is twice as high. Of 1000 such starts the least that diverged had 2.05 at 5e-4 s, 2.3 at 2e-4 s
and 2.7 at 1e-4 s, in helices of 0.3 to 1 m; in straight tubes 2.6, 4.8, and none at 1e-4 s."""
START_LOAD, LOADED_STEP = 3.0, 1e-4
"""[1/m], of T / (P_E d), T as above, P_E Euler's load of a pitch, d the helix diameter; longest step beyond it [s]. Of
2304 random designs that started at 2e-4 s with the couple of the study, 36 diverged, from 3.3 on, 20 of them below
``START_LIMIT`` (from 0.62 m/s on); of 14 of these at 1e-4 and 5e-5 s one. None diverges if the bent span shortens or
the couple counts from the tangent: this limit is not applied then."""


class Sliding(NamedTuple):
    """Steady sliding: greatest tension [N], penetration of the wall there [m] and displacement of the tip [m]."""

    tension: float
    depth: float
    slide: float


def check_fidelity(fidelity: Fidelity, config: TaskConfig) -> None:
    """Raise ValueError if a fidelity cannot simulate a task in any tube."""
    check_scene(fidelity.simulated_method, config.scene)
    whole_steps("config.period / fidelity.time_lapse", config.period / fidelity.time_lapse, fidelity.time_step)
    if config.returns or fidelity.steady_feed is not None:
        whole_steps("config.period", config.period, fidelity.time_step)


def check_simulable(scene: Scene, fidelity: Fidelity, max_length: float, max_air: float) -> None:
    """Raise ValueError if a fidelity cannot simulate an episode that begins at rest in a scene.

    ``max_length`` is the inserted length at its end [m], ``max_air`` the greatest air supply [m3/s].
    """
    stiffness, diameter, probe = scene.contact.stiffness, scene.tube.helix_diameter, scene.probe
    try:
        limit = _max_step(fidelity.simulated_method, scene, fidelity.nodes_per_pitch)
    except ValueError as error:
        raise ValueError(
            f"contact_stiffness = {stiffness:g} N/m: {error}: give fidelity = {_stable_settings(fidelity, scene)}"
        ) from error
    if fidelity.time_step > limit * (1.0 + 1e-9):
        raise ValueError(
            f"contact_stiffness = {stiffness:g} N/m: {fidelity.method_name} needs a time step of at most {limit:.3g} s,"
            f" and that of this fidelity is {fidelity.time_step:g} s: give fidelity ="
            f" {_stable_settings(fidelity, scene)}"
        )
    softest = softest_wall(probe)
    if stiffness < softest:
        raise ValueError(
            f"contact_stiffness = {stiffness:g} N/m is below {softest:.4g} N/m (pi^4 EI / (4 p^3)): the wall is softer"
            " than the buckling limit; give a stiffer contact"
        )
    clearance = scene.tube.clear_diameter - max(probe.guide_float_diameter, probe.carrier_float_diameter)
    start = steady_sliding(scene, scene.inserted_length, scene.air_supply_rate, friction=0.0)
    end = steady_sliding(scene, max_length, max_air, scene.contact.friction)
    tube = (
        f"helix_diameter = {diameter:g} m with contact_stiffness = {stiffness:g} N/m and a drag coefficient of"
        f" {scene.air.drag_coefficient:g}"
    )
    if end.depth > clearance:
        raise ValueError(
            f"{tube}: at {3600.0 * max_air:g} m3/h and {max_length:g} m drag presses the floats"
            f" {1e3 * end.depth:.2g} mm"
            f" into the wall, and the clearance is {1e3 * clearance:.2g} mm; {REMEDY}"
        )
    turn = max(start.slide, end.slide) * 2.0 / diameter
    if turn > MAX_TURN:
        raise ValueError(
            f"{tube}: drag stretches the probe and presses it into the wall so that it turns by {turn:.2g} rad along"
            f" the helix, and the model holds up to {MAX_TURN:g} rad; {REMEDY}"
        )
    sliding = _expanding(scene, max_length, max_air) if scene.air.compressible else end.tension
    tension_limit = _tension_step(fidelity.simulated_method, scene, start.tension, sliding)
    if fidelity.time_step > tension_limit * (1.0 + 1e-9):
        at_start = _tension_step(fidelity.simulated_method, scene, start.tension, 0.0) == tension_limit
        pull = f"{start.tension:.3g} N as it starts from rest" if at_start else f"{sliding:.3g} N as it slides"
        raise ValueError(
            f"{tube}: drag pulls the probe with {pull}: {fidelity.method_name} needs a time step of at most"
            f" {tension_limit:.3g} s, and that of this fidelity is {fidelity.time_step:g} s: give fidelity ="
            f" {_stable_settings(fidelity, scene, start.tension, sliding)}"
        )


def softest_wall(probe: Probe) -> float:
    """Contact stiffness [N/m] below which the cable buckles through the wall, not between floats."""
    return math.pi**4 * probe.flexural_rigidity / (4.0 * probe.float_pitch**3)


def steady_sliding(scene: Scene, length: float, air_supply_rate: float, friction: float) -> Sliding:
    """Tension, penetration and displacement of ``length`` metres of probe under drag alone, without feed.

    dT/ds = q - mu' T / r from the tip on, mu' = mu (1 - d_f / D); an element gives T / EA and T p / (k r^2).
    """
    probe, radius = scene.probe, scene.tube.helix_diameter / 2.0
    pressure = 0.5 * scene.air.drag_coefficient * scene.air.density * air_speed(scene, air_supply_rate) ** 2
    guide = min(probe.guide_length, length)
    tension = maximum = whole = 0.0
    for diameter, section in ((probe.guide_float_diameter, guide), (probe.carrier_float_diameter, length - guide)):
        drag = pressure * math.pi / 4.0 * (diameter**2 - probe.cable_diameter**2) / probe.float_pitch
        decay = friction * (1.0 - diameter / scene.tube.helix_diameter) / radius
        if decay * section < 1e-6:  # the limit: the other form cancels
            whole += tension * section + 0.5 * drag * section**2
            tension += drag * section
        else:
            asymptote, factor = drag / decay, math.exp(-decay * section)
            whole += asymptote * section + (tension - asymptote) * (1.0 - factor) / decay
            tension = asymptote + (tension - asymptote) * factor
        maximum = max(maximum, tension)
    sinking = probe.float_pitch / (scene.contact.stiffness * radius)
    return Sliding(maximum, maximum * sinking, whole * (1.0 / probe.tensile_rigidity + sinking / radius))


def _expanding(scene: Scene, length: float, air_supply_rate: float) -> float:
    """Greatest tension [N] of ``steady_sliding`` with friction in air that expands towards the exit."""
    carrier = max(whole_pitches(length - scene.probe.guide_length, scene.probe), scene.probe.float_pitch)
    update = {"carrier_length": carrier, "air_supply_rate": air_supply_rate, "feed_speed": 0.0}
    return float(steady_tensions(scene.model_copy(update=update), weight=0.0).max())


def _max_step(method: Method, scene: Scene, nodes_per_pitch: int) -> float:
    """Longest step known to be stable [s], else the longest that contact allows."""
    return method.stable_step(scene, nodes_per_pitch) or method.contact_step(scene, nodes_per_pitch)


def _tension_step(method: Method, scene: Scene, start: float, end: float) -> float:
    """Longest stable step [s] for tensions [N] at the start and at the end; no limit is known for nodes."""
    probe, as_printed = scene.probe, scene.couple == "frame" and not scene.terms.shortening
    if method.on_nodes:
        return math.inf
    loaded = as_printed and start > START_LOAD * scene.tube.helix_diameter * buckling_load(probe)
    pitch = probe.line_density * probe.float_pitch
    return min(
        LOADED_STEP if loaded else math.inf,
        START_LIMIT * pitch / max(start, 1e-9),
        math.sqrt(PULL_LIMIT * pitch * probe.float_pitch / max(end, 1e-9)),
    )


def _stable_settings(fidelity: Fidelity, scene: Scene, start: float = 0.0, end: float = 0.0) -> str:
    """Stable settings with a round step: the same method, else double precision, else nodes."""
    steps = [float(f"{digit}e{power}") for power in range(-2, -8, -1) for digit in (5, 2, 1)]
    present = fidelity.simulated_method
    for method in dict.fromkeys((present, present.in_double, METHODS["imex"])):
        nodes = fidelity.nodes_per_pitch if method.on_nodes == present.on_nodes else MESH_NODES
        try:
            limit = min(_max_step(method, scene, nodes), _tension_step(method, scene, start, end))
        except ValueError:
            continue
        step = next((value for value in steps if SHORTEST_STEP <= value <= limit), 0.0)
        if step and step >= method.min_step:
            return repr(fidelity.model_dump() | {"method": method.name, "time_step": step, "nodes_per_pitch": nodes})
    return repr(fidelity.model_dump() | {"method": "implicit"})
