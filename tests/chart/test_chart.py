"""The chart: its closed forms, its slopes, its intervals, and stored rows that are run again."""

from dataclasses import astuple
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles.chains import bent, matrices, plain_chain
from oracles.scatter import CHANCE, hits_within, reach
from scipy.linalg import expm
from scipy.stats import linregress, norm

from agents.chart import ensembles, insertions, report, smooth
from agents.chart.ensembles import Setting, open_store, run_ensembles, run_setting
from agents.chart.figures import RESOLVED, resolved
from agents.chart.report import draw_chart
from agents.records.store import stored_rows
from agents.rollouts.statistics import ratio_interval
from probe_env.files import FileError
from probe_env.physics import closed_forms
from probe_env.physics.closed_forms.bare_chains import LAPACK

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "results" / "chart"
SMOOTH = stored_rows(FOLDER / "smooth.csv")


def test_modal_closed_form_equals_the_matrix_exponential():
    chain = bent(plain_chain(6))._replace(damping_time=5e-5)
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


@pytest.mark.parametrize(
    ("scene", "method", "expected", "margin"),
    [
        ("linear", "newmark", 2.0, 0.1),
        ("linear", "wilson", 2.0, 0.1),
        ("linear", "imex", 1.95, 0.1),  # below the damping time
        ("linear", "implicit", 1.95, 0.1),
        ("linear-printed", "newmark", 1.0, 0.1),
        ("linear-printed", "wilson", 1.0, 0.1),
        ("step-load", "newmark", 1.0, 0.1),
        ("step-load", "imex", 1.0, 0.1),
    ],
)
def test_slopes_are_those_of_theory(scene, method, expected, margin):
    """Fitted over the finest steps above rounding."""
    rows = SMOOTH[(SMOOTH["scene"] == scene) & (SMOOTH["method"] == method) & (SMOOTH["error"] > 1e-8)]
    rows = rows.sort_values("time_step_s").head(3)
    assert linregress(np.log(rows["time_step_s"]), np.log(rows["error"])).slope == pytest.approx(expected, abs=margin)


def test_the_references_agree_to_a_tenth_of_the_smallest_error_shown():
    difference = float(SMOOTH.loc[SMOOTH["method"] == "references", "error"].iloc[0])
    shown = resolved(SMOOTH, "contact")["error"].dropna()
    assert len(shown) > 20
    assert difference <= shown.min() / RESOLVED


@pytest.mark.processor
@pytest.mark.parametrize(
    ("scene", "method", "time_step"),
    [
        ("linear", "newmark", 1e-4),
        ("linear", "newmark", 5e-4),
        ("step-load", "imex", 1e-4),
        ("impact", "implicit", 5e-5),
        ("linear", "explicit", 1e-4),
    ],
)
def test_stored_errors_are_found_again(scene, method, time_step):
    case = smooth.cases()[scene]
    row = SMOOTH[(SMOOTH["scene"] == scene) & (SMOOTH["method"] == method) & (SMOOTH["time_step_s"] == time_step)]
    signal, _, sweeps = smooth.integrate(case, method, time_step)
    if signal is None:
        assert np.isnan(row["error"].iloc[0])
        return
    assert case.exact is not None
    truth = case.exact(case.sample_period * np.arange(1, len(signal) + 1))
    error = np.abs(signal - truth).max() / np.abs(truth).max()
    # 0.1 % of what the method is off, and rounding: 5 % of the least error here
    rounding = rounding_of(scene, time_step)
    assert error == pytest.approx(row["error"].iloc[0], rel=1e-3, abs=rounding)
    assert rounding < 0.1 * row["error"].iloc[0]
    assert sweeps == pytest.approx(row["sweeps"].iloc[0])


def rounding_of(scene, time_step):
    """Of an error: a displacement's last digit is 4 eps / dt^2 in the acceleration of a step, which n steps sum twice,
    for every node that a sweep passes."""
    case = smooth.cases()[scene]
    return 4.0 * (case.duration / time_step) ** 2 * np.finfo(float).eps * case.driven.chain.node_count


ERRORS = ("errors.csv", "insertion-errors.csv", "errors-converged.csv", "insertion-errors-converged.csv")


def test_lapack_gives_newmark_s_errors_at_a_higher_price():
    both = SMOOTH[SMOOTH["method"].isin(["newmark", LAPACK]) & (SMOOTH["scene"] != "contact")]
    table = both.pivot_table(["error", "cpu_s"], ["scene", "time_step_s"], "method").dropna()
    assert len(table) > 8
    for (scene, time_step), error in table["error"].iterrows():
        rounding = 2.0 * rounding_of(scene, time_step)
        assert error[LAPACK] == pytest.approx(error["newmark"], rel=1e-3, abs=rounding)
        assert rounding < 0.2 * error["newmark"]
    assert (table["cpu_s"][LAPACK] > 2.0 * table["cpu_s"]["newmark"]).all()


@pytest.mark.processor
def test_stored_members_are_found_again():
    """Four members of a stored ensemble in a smaller batch; rounding of another processor grows in contact chatter.

    So a member is another draw, of the relative deviations that the 32 stored members have. A tenth of an rms is
    noticed, and any change of a mean.
    """
    setting = Setting(time_step=2.5e-4, length=10.0, members=4)
    repeated = pd.DataFrame(run_setting(setting))
    stored = stored_rows(FOLDER / "ensembles.csv")
    stored = stored[(stored[list(setting.key)] == list(setting.key.values())).all(axis=1) & (stored["member"] < 4)]
    deviations = {"axial_mean_m": 1e-4, "tension_mean_n": 5e-5, "radial_rms_m": 0.018, "axial_rms_m": 0.017}
    for name, deviation in deviations.items():
        chance = reach((deviation, 1), (deviation, 1), chance=CHANCE / 16)  # four members, four names
        assert np.allclose(repeated[name], stored[name], rtol=chance)


@pytest.mark.processor
def test_ratio_intervals_cover_and_equal_the_normal_ones(seeds):
    """Means of 24 against 24, scatter 10 %: the interval is near mean +- 1.96 standard errors, and covers.

    Of 600 intervals 93 % covered, and their widths were 0.95 to 1.05 times the normal ones, +- 0.018. 80 notice
    a coverage of 78 % half of the time.
    """
    rng = np.random.default_rng(seeds(1))
    covered, trials = 0, 80
    for _ in range(trials):
        first, second = rng.normal(1.2, 0.12, 24), rng.normal(1.0, 0.1, 24)
        ratio, low, high = astuple(ratio_interval(first, second))
        half = 1.96 * ratio * np.sqrt(np.var(first) / 24 / 1.44 + np.var(second) / 24)
        assert high - low == pytest.approx(2.0 * half, rel=6.0 * 0.018)  # 80 times a chance of 2e-9, and some skewness
        covered += low <= 1.2 <= high
    least, most = hits_within(trials, 0.92, 0.96)
    assert least <= covered <= most


def test_an_interrupted_chart_goes_on(tmp_path, monkeypatch):
    settings = [Setting(length=5.0, time_step=dt, members=2) for dt in (1e-3 / 7, 2.5e-4, 5e-4)]
    monkeypatch.setattr(ensembles, "step_settings", lambda: iter(settings))
    for name in ("model_settings", "converged_settings"):
        monkeypatch.setattr(ensembles, name, lambda: iter(()))
    run, ran = ensembles.run_setting, []

    def breaks_off(setting):
        if len(ran) == 1:
            raise KeyboardInterrupt
        ran.append(setting)
        return run(setting)

    monkeypatch.setattr(ensembles, "run_setting", breaks_off)
    with pytest.raises(KeyboardInterrupt):
        run_ensembles(tmp_path)
    monkeypatch.setattr(ensembles, "run_setting", lambda setting: ran.append(setting) or run(setting))
    table = run_ensembles(tmp_path)
    assert len(ran) == 3  # nothing twice
    assert len(table) == 6
    assert table.groupby("time_step_s")["diverged"].all().to_dict() == {1e-3 / 7: False, 2.5e-4: False, 5e-4: True}
    run_ensembles(tmp_path)
    assert len(ran) == 3  # no short decimal tells a seventh of a millisecond, and it is found again


def test_the_figures_and_tables_come_from_the_stored_runs(tmp_path, monkeypatch):
    """What `make chart` draws without running anything; the shipped table of "auto" is that of the stored runs."""
    monkeypatch.chdir(ROOT)
    for name in ("smooth", "ensembles", "insertions", "costs"):
        (tmp_path / f"{name}.csv").write_text((FOLDER / f"{name}.csv").read_text())
    draw_chart(tmp_path, tmp_path / "measured_errors.csv")
    assert all((tmp_path / f"{name}.png").stat().st_size > 10_000 for name in ("smooth", "chaos", "model"))
    for name in ERRORS:
        assert (tmp_path / name).read_text() == (FOLDER / name).read_text()
    shipped = ROOT / "probe_env" / "data" / "measured_errors.csv"
    assert (tmp_path / "measured_errors.csv").read_text() == shipped.read_text()


def test_every_setting_of_the_chart_is_stored():
    constant, inserted, _, converged = (pd.read_csv(FOLDER / name) for name in ERRORS)
    store = open_store(FOLDER)
    for setting in (*ensembles.step_settings(), *ensembles.model_settings(), *ensembles.converged_settings()):
        assert store.has(*setting.key.values(), setting.members - 1)
    assert len(inserted) == len(converged) == 2 * len(insertions.INSERTIONS)
    beyond = constant[(constant["method"] == "imex") & (constant["time_step_s"] >= 5e-4)]
    beyond = beyond[beyond["contact_stiffness_n_per_m"] == 1e5]
    assert (beyond["diverged"] == 1.0).all()


SUPERELEMENTS = ("radial_rms_m", "radial_p99_m", "lift_off_share", "axial_rms_m", "radial_acceleration_rms_m_per_s2")


def errors_at(method: str, nodes: int) -> pd.DataFrame:
    """Stored ratios to the converged mesh at 2e-4 s, by length."""
    errors = pd.read_csv(FOLDER / "errors-converged.csv")
    chosen = (errors["contact_stiffness_n_per_m"] == 1e5) & (errors["time_step_s"] == 2e-4)
    chosen &= (errors["method"] == method) & (errors["nodes_per_pitch"] == nodes)
    return errors[chosen].set_index("carrier_length_m").loc[[30.0, 40.0, 50.0]]


def test_the_stored_statistics_of_superelements_are_the_converged_mesh_s():
    """Truths within a tenth: of members made anew all 15 ratios are so but for chance, which their intervals tell."""
    rows = errors_at("superelement32", 4)
    least = norm.isf(CHANCE / (3 * len(SUPERELEMENTS)))
    for output in SUPERELEMENTS:
        ratio, low, high = (np.log(rows[f"{output}:{part}"]) for part in ("ratio", "low", "high"))
        scatter = (high - low) / (2.0 * norm.isf(0.025))
        assert (np.abs(ratio) < np.log(1.1) + least * scatter).all()
    # 0.67, 0.68 and 0.79, each +- 0.03: of members made anew 7, 7 and 6 standard deviations from these
    coarse = errors_at("imex32", 4)["radial_rms_m:ratio"]
    assert (coarse < [0.9, 0.9, 1.0]).all()


def test_the_page_says_within_a_tenth_while_what_is_stored_is():
    """Rounded figures of the stored table, which cannot change but with it; then the sentence must, too."""
    rows = errors_at("superelement32", 4)
    within = all((np.abs(rows[f"{output}:ratio"] - 1.0) < 0.1).all() for output in SUPERELEMENTS)
    page = (ROOT / "docs" / "superelement.md").read_text()
    assert ("`superelement32` at 2e-4 s is within a tenth" in page) == within


@pytest.mark.parametrize("name", ["ensembles", "insertions", "smooth", "costs"])
def test_what_is_stored_is_read_before_anything_is_run(name, tmp_path, monkeypatch):
    for function in ("run_ensembles", "run_insertions", "run_smooth", "run_costs"):
        monkeypatch.setattr(report, function, lambda output: pytest.fail("something was run"))
    (tmp_path / f"{name}.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FileError, match=rf"{name}.csv: column '(code|method)' is missing; found: a, b"):
        report.run_chart(tmp_path, tmp_path / "measured_errors.csv")
