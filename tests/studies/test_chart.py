"""The chart: closed forms, orders, intervals, stored rows that are run again, and resuming."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles.chains import bent, matrices, uniform_chain
from scipy.linalg import expm

from probe_agents.studies import chart, smooth
from probe_agents.studies.chart import SEGMENT, Setting
from probe_agents.studies.smooth import orders, resolved
from probe_env.files import FileError
from probe_env.physics import closed_forms

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "results" / "chart"


def test_modal_closed_form_equals_the_matrix_exponential():
    chain = bent(uniform_chain(6))._replace(damping_time=5e-5)
    M, K = matrices(chain)
    rng = np.random.default_rng(0)
    before, load = rng.normal(size=(2, 6, 3)) * (1.0, 1e-2, 1e-4)
    flow = np.linalg.solve(M, K)
    system = np.block([[np.zeros((18, 18)), np.eye(18)], [-flow, -5e-5 * flow]])
    rest, start = (np.linalg.solve(K, force.ravel()) for force in (load, before))
    moved = expm(system * 0.003) @ np.concatenate([start - rest, np.zeros(18)])
    closed = closed_forms.linear_chain(chain, np.array([0.003]), before, load)[0].ravel()
    assert np.abs(closed - (rest + moved[:18])).max() <= 1e-9 * np.abs(rest).max()


def test_impact_keeps_speed_and_lasts_half_a_period():
    omega = np.sqrt(1e5 / 2.775e-3)
    times = np.linspace(0.0, 4e-3, 4001)
    y = closed_forms.impact(2.775e-3, 1e5, 1e-4, 0.1, times)
    assert np.gradient(y, times)[-1] == pytest.approx(0.1)
    assert (y < 0.0).sum() * 1e-6 == pytest.approx(np.pi / omega, rel=5e-3)
    assert y.min() == pytest.approx(-0.1 / omega, rel=1e-4)


def test_orders_are_fitted_above_rounding_and_references():
    """Errors of dt and dt^2 with a floor of 1e-9; those below ten times the references' difference are left out."""
    steps = np.array(smooth.LONG)
    rows = [
        {"scene": scene, "method": method, "time_step_s": step, "error": 10.0 * step**order + 1e-9}
        for scene, method, order in (("linear", "newmark", 2), ("step-load", "imex", 1), ("contact", "imex", 1))
        for step in steps
    ]
    rows += [{"scene": "linear", "method": "imex32", "time_step_s": step, "error": 1e-6 / step} for step in steps]
    rows.append({"scene": "contact", "method": smooth.REFERENCE_ROWS, "time_step_s": 0.0, "error": 1e-4})
    table = pd.DataFrame(rows)
    found = orders(table).set_index(["scene", "method"])
    fitted = [found.loc[case, "order"] for case in (("linear", "newmark"), ("step-load", "imex"))]
    assert fitted == pytest.approx([2.0, 1.0], abs=0.05)
    assert np.isnan(found.loc[("linear", "imex32"), "order"])  # rounding grows as the step shrinks
    assert found.loc[("linear", "imex32"), "time_step_s"] == steps.max()
    assert resolved(table, "contact")["error"].min() >= 1e-3


def test_errors_of_the_whole_model_are_those_of_its_own_runs(tmp_path, monkeypatch):
    """The ratio of the reference is one. The root tension of the study's model is a quarter greater."""
    monkeypatch.setattr(chart, "DURATION", 0.2)
    monkeypatch.setattr(chart, "SETTLE", 0.2)
    reference = replace(chart.converged(10.0, Setting.stiffness, 2), whole=True)
    other = Setting("imex32", length=10.0, members=8, whole=True)
    monkeypatch.setattr(chart, "WHOLE", (reference, other))
    chart.run(tmp_path, "whole")
    errors = pd.read_csv(tmp_path / "errors.csv").set_index("method")
    assert errors.loc["imex", "tension_mean_n:ratio"] == 1.0
    assert errors.loc["imex32", "tension_mean_n:ratio"] == pytest.approx(1.0, abs=0.05)
    rows = pd.read_csv(tmp_path / "ensembles.csv").groupby("method")["tension_mean_n"].mean()
    assert errors["tension_mean_n:reference"].to_numpy() == pytest.approx(rows["imex"], rel=1e-3)
    scene = reference.batch(1).simulators[0].scene
    assert scene == replace(reference, whole=False).batch(1).simulators[0].scene.whole()


def test_stored_errors_of_the_whole_model_are_those_of_its_runs():
    stored = pd.read_csv(FOLDER / "whole" / "errors.csv")
    outputs = [name.removesuffix(":ratio") for name in stored if name.endswith(":ratio")]
    computed = chart.constant_length(pd.read_csv(FOLDER / "whole" / "ensembles.csv"), outputs)
    pd.testing.assert_frame_equal(computed, stored, rtol=1e-3, check_dtype=False)


def test_an_insertion_is_a_row_a_stretch_and_member():
    insertion = chart.Insertion("superelement32", time_lapse=20.0, members=2)
    rows = pd.DataFrame(insertion.rows(chart.START + 2 * SEGMENT))
    assert rows[["from_m", "member"]].to_numpy().tolist() == [[5.0, 0], [5.0, 1], [10.0, 0], [10.0, 1]]
    assert (rows["tension_mean_n"].diff(2).dropna() > 0.0).all()  # a longer probe pulls more


@pytest.mark.slow
def test_the_figures_and_tables_come_from_the_stored_runs(tmp_path):
    """Drawn without running anything; the shipped table of "auto" is that of the stored runs."""
    for name in ("smooth", "ensembles", "insertions", "costs"):
        (tmp_path / f"{name}.csv").write_text((FOLDER / f"{name}.csv").read_text())
    chart.draw_chart(tmp_path)
    assert all((tmp_path / f"{name}.png").stat().st_size > 10_000 for name in ("smooth", "chaos"))
    shipped = ROOT / "probe_env" / "data" / "measured_errors.csv"
    names = ("errors", "insertion-errors", "time-lapse-errors", "orders", "choices", "presets")
    for path in (shipped, *(FOLDER / f"{name}.csv" for name in names)):
        # four digits are stored, of which the last may be rounded otherwise
        pd.testing.assert_frame_equal(pd.read_csv(tmp_path / path.name), pd.read_csv(path), rtol=1e-3)


def test_a_known_bias_of_time_lapse_is_found():
    """All members of a factor equal: the ratio of every output is exact, and an rms is pooled as a square."""
    rows = [
        chart.NO_TIME_LAPSE.key | {"time_lapse": lapse, "member": member, "from_m": start}
        | dict.fromkeys(chart.OUTPUTS, (1.5 if lapse > 1.0 else 1.0) * (1.0 if start % 10.0 else 7.0))
        for lapse in (1.0, 4.0) for member in range(3) for start in np.arange(5.0, 60.0, SEGMENT)
    ]  # fmt: skip
    costs = pd.DataFrame([{"method": chart.NO_TIME_LAPSE.method, "nodes_per_pitch": 4, "ns_per_node_step": 1.0}])
    table = chart.time_lapse(pd.DataFrame(rows), costs)
    assert table["from_m"].tolist() == [20.0, 30.0, 40.0, 50.0]
    assert table["radial_rms_m:ratio"].to_numpy() == pytest.approx(1.5)
    assert table["radial_rms_m:reference"].to_numpy() == pytest.approx(5.0)  # of 7 and 1
    assert table["lift_off_share:reference"].to_numpy() == pytest.approx(4.0)


def test_stored_tables_are_read_before_anything_is_run(tmp_path, monkeypatch):
    monkeypatch.setattr("probe_agents.studies.chart.Store.fill", lambda *_: pytest.fail("something was run"))
    for name in ("ensembles", "insertions", "smooth"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / f"{name}.csv").write_text("a,b\n1,2\n")
        with pytest.raises(FileError, match=rf"{name}.csv: column 'commit' is missing; found: a, b"):
            chart.run(folder)
