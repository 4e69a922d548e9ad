"""Order of convergence of a method from runs at halved steps, without a reference solution."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.stats import linregress


def observed_order(
    run: Callable[[float], npt.NDArray[np.float64]], time_steps: Sequence[float]
) -> tuple[float, float, npt.NDArray[np.float64]]:
    """Order of convergence, relative error at the last step, and the signal there; ``run``: signal for a time step.

    Runs of order p at dt and dt / 2 differ by (2^p - 1) e(dt / 2) with e ~ dt^p: the slope of the differences is p,
    and the last difference divided by 2^p - 1 is the remaining error.
    """
    ratios = np.divide(time_steps[:-1], time_steps[1:])
    assert len(time_steps) >= 3
    assert np.allclose(ratios, 2.0)
    signals = [run(dt) for dt in time_steps]
    scale = np.abs(signals[-1]).max()
    differences = [np.abs(a - b).max() / scale for a, b in pairwise(signals)]
    order = float(linregress(np.log(time_steps[:-1]), np.log(differences)).slope)
    return order, differences[-1] / (2.0**order - 1.0), signals[-1]
