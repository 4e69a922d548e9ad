"""Vibration of a withdrawn probe after a change of the feed."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from agents.studies import feed_changes
from agents.studies.builtin import Request
from probe_env.scene import Scene


def test_friction_follows_from_the_exponent() -> None:
    """Exponent = friction times inserted length over the helix's radius, with the guide inserted as well."""
    scene = feed_changes.scene_of(9.0, 25.0, 1.2)
    inserted = 25.0 + Scene().probe.guide_length
    assert scene.contact.friction * inserted / 0.6 == pytest.approx(9.0)
    assert (scene.feed_speed, scene.contact.cable) == (feed_changes.FROM, True)


@pytest.mark.slow
def test_a_change_shakes_more_than_none_and_members_differ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "EXPONENTS": (15.0,), "TUBES": ((12.5, 1.2),), "RAMPS": (0.5, 0.0), "MEMBERS": 2, "SETTLING": 4.0,
    }.items():  # fmt: skip
        monkeypatch.setattr(feed_changes, name, value)
    table = feed_changes.run(Request(tmp_path))
    assert len(table) == 2 * 2
    stored = pd.read_csv(tmp_path / "changes.csv")
    assert list(stored.columns) == list(feed_changes.COLUMNS)
    rms = stored.set_index(["ramp", "member"])["radial_rms_m"]
    assert rms[0.5].min() > rms[0.0].max()
