"""The map of the noise in a flaw's band, which is heard as a running mean."""

import numpy as np
import pandas as pd

from agents.studies.shipped.vibration_map import SEGMENT, SMEARED, fit_map
from probe_env import Scene

TUBES = 14


def wandered(heard_before: float) -> pd.DataFrame:
    """Metres of wandering insertions whose noise is 0.1 mm times feed / (0.1 m/s), of the segment before at first.

    ``heard_before``: length [m] over which a segment hears the feed before it.
    """
    rng, segment = np.random.default_rng(0), SEGMENT["snr"]
    rows = []
    for tube in range(TUBES):
        feeds = 0.04 * 10.0 ** rng.uniform(size=11)
        context = {"friction": 0.1 + 0.005 * tube, "contact_stiffness": 1e5, "drag_factor": 1.0, "helix_diameter": 1.5}
        for length in np.arange(5.5, 60.0):
            k, into = int(length / segment), length % segment
            heard = feeds[k - 1] if k and into < heard_before else feeds[k]
            rows.append(
                {"inserted_length": length, "feed_speed": feeds[k], "air_supply_rate": 0.02, "context": tube,
                 "noise_rms_m": 1e-3 * heard, **context}
            )  # fmt: skip
    return pd.DataFrame(rows)


def error(smeared: float) -> float:
    """Mean absolute error [decades] of the map on the tubes that were left out."""
    return fit_map(wandered(smeared), scene=Scene(), measure="snr")[1]["mean_absolute_error_decades"]


def test_what_a_segment_hears_of_the_one_before_is_not_fitted() -> None:
    """Metres that hear another feed change nothing, not a digit; one metre more of them does."""
    assert error(SMEARED["snr"]) == error(0.0)
    assert error(SMEARED["snr"] + 1.0) > error(0.0)
