"""The cantilever beside other packages: ours here, the others as stored, since they are no dependency."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.chart.peers import comparison as peers
from agents.chart.peers import models

STORED = Path(__file__).parents[2] / "results/chart"
ELEMENTS, DURATION = 40, models.SAMPLES * models.SAMPLE_PERIOD
# half a mass more at the tip, rho h / 2, mixes modes 1 and k by 2 (h / L) / ((beta_k / beta_1)^4 - 1), at the tip where
# all are equal; the sum over k = 2, 3, ... of the shares is 0.062 h / L, and a share may be off by twice itself
OTHER_MODES = 0.13


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Two of our settings and the other packages as if they were not there."""
    few = {"probe-env": replace(peers.PEERS["probe-env"], settings=(("newmark", 40, 1e-2), ("explicit", 40, 3.125e-5)))}
    gone = {name: replace(peer, module="no_such_package") for name, peer in peers.PEERS.items() if name not in few}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(peers, "PEERS", few | gone)
        return peers.run_peers(tmp_path_factory.mktemp("peers"))


def test_the_chain_is_off_by_its_mesh(table):
    """A whole mass at the tip is half an element of bar more: the period is h / L longer, to second order."""
    row = table[table["method"] == "newmark"].iloc[0]
    h = 1.0 / ELEMENTS
    omega_dt = models.frequency() * row["time_step_s"]
    # as in test_closed_forms: second order in h / L and in beta h, and Newmark's own longer period
    second = h**2 + (models.BETA_L * h) ** 2 / 2.0 + omega_dt**2 / 12.0
    assert row["period_error"] == pytest.approx(h, abs=second)
    assert abs(row["period_error_ends"]) <= second
    # a phase that grows by h a radian; a cosine is off by no more than its phase
    assert row["error"] == pytest.approx(2.0 * math.sin(h * models.frequency() * DURATION / 2.0), rel=0.1)
    assert row["error_ends"] < 0.05 * row["error"]


def test_the_step_alone_is_off_by_the_phase_of_its_modes(table):
    """Newmark lengthens a period by (omega dt)^2 / 12; the other modes in the start may be off by twice their share."""
    row = table[table["method"] == "newmark"].iloc[0]
    omega = models.frequency() / (1.0 + row["period_error"])
    exact = models.exact_ours("newmark", ELEMENTS) / models.AMPLITUDE
    others = np.abs(exact - np.cos(omega * models.sample_times())).max()
    assert others <= OTHER_MODES / ELEMENTS
    phase = (omega * row["time_step_s"]) ** 2 / 12.0 * omega * DURATION
    assert row["time_error"] <= phase + others


def test_the_explicit_method_stops_at_the_axial_waves(table):
    """2 / omega_max = h sqrt(rho / EA) = 25.1 us: at 31.25 us a trace of axial motion grows without bound."""
    limit = 0.025 * math.sqrt(models.LINE_DENSITY / models.EA)
    row = table[table["method"] == "explicit"].iloc[0]
    assert 2.5e-5 < limit < row["time_step_s"]
    assert row["status"] == "diverges"
    assert row[list(peers._FIGURES)].isna().all()


def test_a_missing_package_says_so(table):
    for name in peers.DISTRIBUTIONS:
        status = table.loc[table["package"] == name, "status"]
        assert len(status) > 0
        assert status.str.startswith("not installed: ").all()
    text = peers.markdown(table)
    assert all(f"* {name}: " in text for name in peers.PEERS)


@pytest.mark.parametrize(
    ("name", "method", "length", "ends"),
    [("ours", "", 2.0, 0.5), ("elastica", peers.SOFT, 1.0, -0.5), ("mujoco", "", 1.0, 0.0), ("exudyn", "", 1.0, 0.0)],
)
def test_every_mesh_tends_to_the_bar_of_its_own_length(name, method, length, ends):
    """Own motion of 80 elements: the period is of second order in beta h."""
    elements = 80
    omega = models.frequency(length * (1.0 + ends / elements))
    exact = getattr(models, f"exact_{name}")(method, elements) / models.AMPLITUDE
    error = np.abs(exact - np.cos(omega * models.sample_times())).max()
    others = OTHER_MODES / elements if name == "ours" else 0.0
    assert error <= (models.BETA_L / elements) ** 2 / 2.0 * omega * DURATION + others


def test_stored_rows():
    stored = pd.read_csv(STORED / "peers.csv")
    assert set(stored["package"]) == set(peers.PEERS)
    for _, row in stored.iterrows():
        if row["status"] == peers.RAN:
            assert np.isfinite(row[list(peers._FIGURES)].astype(float)).all()
        elif row["status"] == peers.TIMED:
            assert np.isfinite(row[["cpu_s", "ns_per_node_step"]].astype(float)).all()
        else:
            assert len(row["status"]) > 5
    provenance = json.loads((STORED / "peers-provenance.json").read_text())
    assert provenance["command"] == "probe-env peers --output results/chart"
    assert set(peers.DISTRIBUTIONS.values()) <= set(provenance["packages"])
    assert peers.markdown(stored).count("\n| ") == len(stored)


def test_the_picture_is_drawn(tmp_path):
    assert peers.draw(pd.read_csv(STORED / "peers.csv"), tmp_path / "peers.png").stat().st_size > 10_000
