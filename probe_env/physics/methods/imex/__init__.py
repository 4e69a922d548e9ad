"""The fast scheme, imex: linear part implicit with constant factors, contact, friction and drag explicit.

Constants, states and inputs of some lanes enter; states a number of steps later leave. Imports the drive and what the
methods share.

One step, from displacements d and velocities v at its start:

1. kick: v* = v + dt M^-1 f, f = contact, friction, drag, centrifugal and Coriolis force, the frame's
   acceleration and the couple of (9), all at the present state. Friction acts against the motion of the step
   before, (d - d_before) / dt: v itself holds a ringing of what is too fast for the step, and friction that
   follows its sign feeds it (measured at u = 0.05 m/s, mu = 0.25, 130 m3/h, l = 30 m: a root tension of 1,800 N
   instead of 12);
2. theta rule for M d'' + K (d + delta d') = 0 from (d, v*), theta and tau from ``linear_weights``: with
   w = d + tau v_m, v_m = (1 - theta) v* + theta v, it reads [1 + theta dt tau M^-1 K] w = d + tau v*; then
   v_m = (w - d) / tau, d += dt v_m, v = (v_m - (1 - theta) v*) / theta. K w is the elastic and damping force.

The matrix never changes, so it is eliminated once, from the tip to the root: the factors depend on the
distance from the tip alone, converge after some dozen nodes, and serve probes of any length. First order in
what is explicit, second in the rest. ``explicit`` shares the forces and what follows a step.

Probes run side by side in the lanes of vector registers (see lanes.py): four in double precision (imex), eight
in single (imex32); the arrays decide. A lane has its own parameters, factors, length and inputs; lanes share
nothing but the step size, the nodes a pitch and the number of steps.
"""

from __future__ import annotations

import numpy as np

from probe_env.physics.methods.factors import imex_factors, single_factors
from probe_env.physics.methods.imex.kernel import imex_advance
from probe_env.physics.methods.lane_group import LaneKernel
from probe_env.physics.methods.method import lane_method

IMEX = lane_method("imex", LaneKernel(imex_advance, imex_factors, np.float64), order=2, usual_step=2e-4)

# in the return a probe lies back by some 0.4 m, whose rounding in single precision lifts it off the wall by 0.1 mm
IMEX32 = lane_method(
    "imex32", LaneKernel(imex_advance, single_factors, np.float32), order=2, usual_step=2e-4, least_step=5e-5,
    draws_back=False,
)  # fmt: skip
