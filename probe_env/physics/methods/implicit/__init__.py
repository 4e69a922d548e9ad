"""The method that does not diverge: contact, friction and walls solved within the step, over the TICM recursion.

A chain, a state and inputs enter; the state a number of steps later leaves. Imports the TICM, the drive and what the
methods share.

The elastic part is a theta rule: with v_m = (1 - theta) v + theta v_new and w = d + tau v_m a step reads
[M / (tau theta dt) + K] w = M (d / (tau theta dt) + v / (theta dt)) + f and d_new = d + dt v_m, with the weights of
``factors.implicit_weights``. So w is the solution of (17)-(18) without damping terms, and K w the elastic and
damping force. What is in f, and why a passive probe gains no energy from it:

* contact is the spring of (11), taken at d + zeta (d_new - d) where the step starts in the wall, zeta = 1/2 for short
  steps, and at d_new where it meets the wall: never more work than the potential that the step uses up. Between
  floats the cable itself meets the wall. Deeper than 10 mm a wall has 1e7 N/m;
* friction opposes the slide of the contact point during the step, u + v_m, with mu N at d_new. Below a slide of
  mu N / c it sticks: a linear law with c = 100 m / (theta dt), which creeps some micrometres per second;
* the couple V l theta of (9) with the axial force of the step before: a tension is taken at d_new (convex), a
  compression at d (concave), within ``couple_limits``: what V gains from step to step is all that it can feed;
* drag is linearised about the speed of the step before, Coriolis and centrifugal force use that speed.

Contact and friction make the system piecewise linear. A semi-smooth Newton iteration solves it with the flags of
the last iterate until no contact force is off by more than ``TOLERANCE``; from ``HALF_STEPS_FROM`` on the iterate goes
half way only. If ``FREEZE_AFTER`` iterations do not do it, friction is bounded by what it was then (Tresca's law, a
convex problem, dissipative too); after ``MOST_ITERATIONS`` the last solution is taken. Such steps are counted as
not converged.
"""

from __future__ import annotations

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import implicit_weights
from probe_env.physics.methods.implicit.contact import contact_places
from probe_env.physics.methods.implicit.iteration import advance
from probe_env.physics.methods.implicit.rows import couple_limits
from probe_env.physics.methods.implicit.solution import workspace
from probe_env.physics.methods.method import Advance, Method
from probe_env.physics.methods.stability import any_step
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.kernel_call import Sampling
from probe_env.physics.model.state import State


def _prepare(chain: Chain, time_step: float, sensor: int, nodes_per_pitch: int) -> Advance:
    weights = (time_step, *implicit_weights(chain.damping_time, time_step))
    limits, places = couple_limits(chain, nodes_per_pitch), contact_places(chain)
    work = workspace(chain.node_count)

    def run(inputs: FloatArray, root: int, state: State, sampling: Sampling) -> tuple[int, int, int, int]:
        result: tuple[int, int, int, int] = advance(
            chain, weights, limits, places, inputs, root, state, work, *sampling
        )
        return result

    return run


IMPLICIT = Method("implicit", _prepare, 2, 1e-4, stable_step=any_step, contact_step=any_step)
