"""The study's claims on the stored ensemble, the return next to the insertion, and single runs of the cases."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import get_window

from probe_agents.records.store import stored_rows
from probe_agents.studies import claims
from probe_agents.studies.claims import CASES, claims_of, highest_peak, insertion_of, run_case, trip
from probe_env.physics.closed_forms import steady_root_tension

ROOT = Path(__file__).parents[2]
TABLE = claims.load_rows(ROOT / "results" / "study")
NAMED = {case.name: case for case in CASES}


@pytest.mark.parametrize("folder", ["study", "study/whole"])
def test_claims_are_computed_from_the_stored_runs(folder):
    computed = claims_of(claims.load_rows(ROOT / "results" / folder))
    stored = pd.read_csv(ROOT / "results" / folder / "claims.csv", dtype={"figure": str})
    pd.testing.assert_frame_equal(computed, stored, rtol=1e-3)


def test_claims_need_the_rows_of_their_cases():
    assert claims_of(TABLE[TABLE["case"].isin(["l10", "l30"])])["claim"].tolist() == [
        "vibration grows with length", "a peak at about 20 Hz",
    ]  # fmt: skip


def pair(back, fed, peak):
    """Four members of a return and its insertion with these radial rms, and highest peak of the return."""
    name = trip("original", 50).name
    return pd.DataFrame(
        {
            "case": case, "member": k, "duration_s": 8.0, "diverged_at_s": 1.5 if diverged else np.nan,
            "radial_rms_m": np.nan if diverged else value * (1 + k / 50),
            "radial_highest_m": high, "axial_highest_m": high,
        }
        for case, value, high, diverged in ((name, back, peak, back >= 1.0), (insertion_of(name), fed, 1e-4, False))
        for k in range(4)
    )  # fmt: skip


def test_verdicts_follow_the_rows():
    for back, peak, less, none in (
        (1e-6, 1e-7, "yes", "yes"),
        (3e-4, 5e-5, "not clearly", "not clearly"),
        (6e-4, 1e-7, "no", "yes"),
        (1e-6, 2e-5, "yes", "not clearly"),
        (1.0, 1e-7, "no", "yes"),
    ):
        holds = claims_of(pair(back, 3e-4, peak)).set_index("claim")["holds"]
        assert holds["less vibration in the return"] == less
        assert holds["no noticeable radial peak in the return from 2 s on: original"] == none


@pytest.mark.parametrize(
    ("rms", "verdict"),
    [((1, 30, 60, 200, 300, 350), "yes"), ((1, 30, 200, 250, 300, 350), "earlier"), ((1, 2, 9, 40, 300, 350), "later")],
)
def test_sharpest_rise_is_that_of_linear_axes(rms, verdict):
    """In the first case the ratio is greatest from 10 to 20 m."""
    rows = [
        {"case": f"l{length}", "member": k, "diverged_at_s": np.nan, "radial_rms_m": 1e-6 * value * (1.0 + k / 500)}
        for length, value in zip(claims.GROWTH, rms, strict=True)
        for k in range(4)
    ]
    holds = claims_of(
        pd.DataFrame(rows).assign(common_peak_hz=14.0, axial_peak_hz=14.0, radial_acceleration_rms_m_per_s2=1.0)
    ).set_index("claim")["holds"]
    assert holds["it rises sharply between 30 and 40 m"] == verdict


def test_withdrawals_differ_in_direction_only():
    for case in filter(lambda case: case.withdrawn, claims.TRIPS):
        fed, back = NAMED[insertion_of(case.name)].load_scene(), case.load_scene()
        assert (back.couple, fed.couple) == ("tangent", "frame")
        assert fed.feed_speed > 0.0 < fed.air_supply_rate
        turned = {"feed_speed": -fed.feed_speed, "air_supply_rate": -fed.air_supply_rate, "couple": "tangent"}
        assert back.model_dump() == fed.model_dump() | turned


def test_whole_cases_are_those_of_the_study_with_all_terms(tmp_path, monkeypatch):
    for case in claims.WHOLE:
        assert case.load_scene() == NAMED[case.name].load_scene().whole()
        assert (case.method, case.time_step) == ("imex", 2e-4)
    compared = {name for name in (case.name for case in CASES) if name.endswith(("wilson", "explicit", "implicit"))}
    assert {case.name for case in claims.WHOLE}.isdisjoint(compared | {"l50-dt2e-4", "l50-dt5e-4"})
    chosen = [case for case in claims.WHOLE if case.name in ("l10", "u100")]
    monkeypatch.setattr(claims, "WHOLE", tuple(chosen))
    monkeypatch.setattr(claims, "DURATION", 0.2)
    claims.run(tmp_path, limit=1, assumptions="whole")
    stored = stored_rows(tmp_path / "ensemble.csv").iloc[0]
    row = run_case(chosen[0], 0, 0.2)
    assert stored["case"] == "l10"
    assert stored["root_tension_mean_n"] == pytest.approx(row["root_tension_mean_n"], rel=1e-5)  # six digits are stored
    study = run_case(replace(chosen[0], whole=False), 0, 0.2)["root_tension_mean_n"]
    assert abs(study / row["root_tension_mean_n"] - 1.0) > 1e-3


@pytest.mark.parametrize("withdrawn", [False, True])
def test_a_short_trip_slides_as_the_closed_form_and_is_repeated(withdrawn):
    """Pressure and pull at the root of 3 m within 1 %; equal to the bit when run again."""
    case = trip("original", 3, withdrawn=withdrawn)
    row = run_case(case, 1, 2.0)
    expected = steady_root_tension(case.load_scene())
    assert row["root_tension_mean_n"] == pytest.approx(expected, rel=0.01)
    assert math.copysign(1.0, row["root_tension_mean_n"]) == (-1.0 if withdrawn else 1.0)
    assert row["radial_mean_m"] == pytest.approx(5.2e-3 if withdrawn else 0.0, abs=1e-4)
    pd.testing.assert_series_equal(pd.Series(run_case(case, 1, 2.0)), pd.Series(row), check_exact=True)


def test_runs_are_stored_and_not_repeated(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(claims, "CASES", tuple(NAMED[name] for name in ("l10", "original-l10-u200-in")))
    monkeypatch.setattr(claims, "DURATION", 0.5)
    claims.run(tmp_path)
    first = stored_rows(tmp_path / "ensemble.csv")
    ran = []
    monkeypatch.setattr(claims, "run_case", lambda case, *at: ran.append((case.name, at[0])) or run_case(case, *at))
    claims.run(tmp_path, trials=2)
    assert sorted(ran) == [("l10", 1), ("original-l10-u200-in", 1)]
    second = stored_rows(tmp_path / "ensemble.csv")
    assert len(second) == 4
    merged = second[second["member"] == 0].sort_values("case").reset_index(drop=True)
    pd.testing.assert_frame_equal(merged[first.columns], first.sort_values("case").reset_index(drop=True))
    monkeypatch.setattr(claims, "DURATION", 0.6)
    claims.run(tmp_path, limit=1)  # of another duration: the first stay
    assert len(stored_rows(tmp_path / "ensemble.csv")) == 5
    assert pd.read_csv(tmp_path / "claims.csv")["case"].tolist() == []
    assert "Claims: 1 run(s) per case, 0.6 s each" in capsys.readouterr().out


PERIOD = 1e-3
TIME = PERIOD * np.arange(6001)


def test_the_amplitude_of_a_sine_is_found():
    """Within 1 Hz of the highest bin a Hann window of 2 s has all but 0.4 % of a sine's power: that share is found.

    Of two sines the greater one is found.
    """
    for hertz, amplitude in ((3.0, 1.0), (14.0, 1.0), (14.2, 1e-7), (55.25, 1e-7)):
        peak, height = highest_peak(amplitude * np.sin(2.0 * np.pi * hertz * TIME + 0.3), PERIOD)
        assert abs(peak - hertz) <= 0.25
        window = get_window("hann", 2000)
        bins = np.arange(-2, 3) * 0.5
        lines = [abs(window @ np.exp(2j * np.pi * (hertz - peak - b) * PERIOD * np.arange(2000))) ** 2 for b in bins]
        fraction = sum(lines) / (2000 * (window**2).sum())
        assert fraction > 0.99
        assert height == pytest.approx(amplitude * np.sqrt(fraction), rel=1e-3)  # its mirror at -f is left
    signal = 1e-3 * np.sin(2.0 * np.pi * 9.0 * TIME) + 3e-3 * np.sin(2.0 * np.pi * 20.0 * TIME)
    assert highest_peak(signal, PERIOD) == (20.0, pytest.approx(3e-3, rel=1e-3))
    assert highest_peak(signal + 5.0 * TIME, PERIOD)[0] in (2.0, 20.0)  # a drift is no peak: means are subtracted
    assert highest_peak(signal[:500], PERIOD)[0] == pytest.approx(20.0, abs=2.0)
