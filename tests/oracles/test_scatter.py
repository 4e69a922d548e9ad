"""Bounds of the statistical tests against tables of Student's t and of the binomial distribution."""

import numpy as np
import pytest

from oracles.scatter import hits_within, of_another, reach


def test_bounds_by_hand():
    """Student's t of 31 degrees exceeds 4.45 with a chance of 1e-4; of 100 coins 32 to 68 heads, but for 1e-4."""
    assert reach((0.3, 9)) == pytest.approx(4.45 * 0.1, rel=1e-2)
    assert reach((0.1, 8), (0.1, 8)) == pytest.approx(4.45 * 0.05, rel=1e-2)
    assert reach((0.3, 9), measured=8) == pytest.approx(7.89 * 0.1, rel=1e-2)  # of 7 degrees
    assert of_another(0.1, members=8) == pytest.approx(4.45 * 0.1 * np.sqrt(1 / 8 + 1 / 32), rel=1e-2)
    assert hits_within(100, 0.5, 0.5) == (32, 68)
