"""What a plant's file leaves open: numbers are known, ranges are ranges, silence is all that was learnt."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.plant.prior import DAMPING, DRAG, FRICTION, STIFFNESS, UNKNOWNS, prior_of
from probe_env import Plant

NAMES = list(UNKNOWNS)


def test_silence_leaves_all_open() -> None:
    """Nothing said: all four are looked for, over what the response was learnt for; drag within 15 % of table 2's."""
    prior = prior_of(Plant())
    assert prior.ranges["friction"] == FRICTION
    assert prior.ranges["contact_stiffness"] == STIFFNESS
    assert prior.ranges["damping_time"] == DAMPING
    assert prior.ranges["drag_coefficient"] == pytest.approx([share * 0.44 for share in DRAG])
    assert len(prior.assumed) == 4


def test_a_number_is_known_but_for_the_friction() -> None:
    """Stiffness, drag and damping stand; the friction is what is asked for."""
    plant = Plant(
        contact={"friction": 0.2, "stiffness": 8e4}, air={"drag_coefficient": 0.4}, probe={"damping_time": 6e-5}
    )
    prior = prior_of(plant)
    assert prior.known == {"contact_stiffness": 8e4, "drag_coefficient": 0.4, "damping_time": 6e-5}
    assert prior.shared == ()
    table = prior.values(np.zeros((3, 2)), 2)
    assert table.shape == (2, 3, 4)
    np.testing.assert_allclose(table[:, :, 1:], np.broadcast_to([8e4, 0.4, 6e-5], (2, 3, 3)))
    np.testing.assert_allclose(table[:, :, 0], sum(FRICTION) / 2.0)


def test_figures_become_their_quantiles() -> None:
    """A standard normal coordinate of 0 is the median, of +-1.645 the 5th and the 95th percentile."""
    plant = Plant(
        contact={"friction": {"low": 0.1, "high": 0.2}, "stiffness": {"mean": 1e5, "std": 1e4}},
        air={"drag_coefficient": 0.44}, probe={"damping_time": 5e-5},
    )  # fmt: skip
    low, middle, high = prior_of(plant).values(np.array([[z, z] for z in (-1.6449, 0.0, 1.6449)]), 1)[0, :, :2]
    np.testing.assert_allclose([low[0], middle[0], high[0]], [0.105, 0.15, 0.195], rtol=1e-4)
    np.testing.assert_allclose([low[1], middle[1], high[1]], [83551.5, 1e5, 116448.5], rtol=1e-3)


@pytest.mark.parametrize(
    ("tables", "problem"),
    [
        ({"contact": {"friction": {"low": 0.1, "high": 0.6}}}, "contact.friction = 0.6 is outside 0.05 to 0.35"),
        ({"contact": {"stiffness": 1e6}}, r"contact.stiffness = 1e\+06 N/m is outside 50000 to 190000 N/m"),
        ({"probe": {"damping_time": 1e-5}}, "probe.damping_time = 1e-05 s is outside"),
        ({"air": {"drag_coefficient": {"mean": 3.0, "std": 0.1}}}, "air.drag_coefficient = 3 is outside"),
    ],
)
def test_what_was_not_learnt_is_refused(tables: dict[str, Any], problem: str) -> None:
    """In one line with the plant's file, the field, the value and the range."""
    with pytest.raises(ValueError, match=f"mine.toml: {problem}"):
        prior_of(Plant.model_validate(tables), "mine.toml")
