"""The calibration response: simulated insertions are kept, and what is learnt from them can be loaded."""

import json

import numpy as np
import pytest

from probe_agents.plant.response import Response
from probe_agents.studies import response

SIZE = 4


SMALL = {"SIZE": SIZE, "LENGTHS": (9.0, 8.0), "FIDELITY": "fast", "MIN_METRES": 1, "LAGS": 2, "EPOCHS": 3, "BATCH": 8}


@pytest.mark.slow
def test_groups_are_simulated_once_and_the_response_is_of_all(tmp_path, monkeypatch):
    """Four insertions a group, into tubes of 9 and 8 m, at fast; three epochs."""
    for name, value in SMALL.items():
        monkeypatch.setattr(response, name, value)
    made = response.run(tmp_path, limit=2)
    with np.load(tmp_path / "fast-001.npz") as bank:
        rows = {name: bank[name] for name in bank.files}
    assert set(np.unique(rows["specimen"])) <= {SIZE + k for k in range(SIZE)}
    assert len({len(values) for values in rows.values()}) == 1
    plant, specimens = response.tubes_of(1)
    assert plant.tube.helix_length == 8.0
    for specimen in np.unique(rows["specimen"]).astype(int):
        part, context = rows["specimen"] == specimen, specimens[specimen - SIZE].context
        assert set(rows["friction"][part]) == {context.friction}
        assert (np.diff(rows["length"][part]) > 0.0).all()
        assert rows["length"][part].max() <= 8.0
    for name, (low, high) in (("feed", response.FEEDS), ("air", response.AIRS)):
        assert low * 0.9 <= rows[name].min() <= rows[name].max() <= high * 1.1
    record = json.loads((tmp_path / "response.json").read_text())
    assert (record["insertions"], record["fidelity"]) == (2 * SIZE, "fast")
    monkeypatch.setattr(response, "simulated", lambda group: pytest.fail(f"group {group} was simulated again"))
    again = response.run(tmp_path, limit=2)
    loaded = Response.load(tmp_path / "response.npz")
    for one, other in ((made, again), (made, loaded)):
        assert all((a[0] == b[0]).all() for a, b in zip(one.layers, other.layers, strict=True))
        np.testing.assert_array_equal(one.misfit, other.misfit)
