"""The study of speed: its tables, and the best of repeats in turns."""

import pandas as pd
import pytest

from agents.studies import speed
from probe_env.physics.methods import METHODS


@pytest.mark.slow
def test_every_method_is_timed_alone_and_in_full_lanes(tmp_path, monkeypatch):
    monkeypatch.setattr(speed, "SIMULATED", 0.01)
    monkeypatch.setattr(speed, "SLOW_SIMULATED", 0.001)
    table = speed.run_speed(tmp_path, repeats=1, environments=(1, 2))
    assert {(name, count) for name in METHODS for count in (1, METHODS[name].width)} == set(
        table[["method", "probes"]].itertuples(index=False, name=None)
    )
    assert table.set_index(["method", "probes"])["ratio"]["newmark", 1] == pytest.approx(1.0)
    assert (table["s_per_simulated_s"] > 0.0).all()
    rates = pd.read_csv(tmp_path / "environments.csv")
    assert rates["environments"].tolist() == [1, 2]
    assert (rates["steps_per_s"] > 0.0).all()


def test_the_best_of_several_rounds_counts(monkeypatch):
    clock = iter([0.0, 3.0, 10.0, 14.0, 20.0, 21.0, 30.0, 35.0])
    monkeypatch.setattr(speed.time, "perf_counter", lambda: next(clock))
    jobs = {("a", 1): lambda: None, ("b", 1): lambda: None}
    assert speed._best_times(jobs, 2) == {("a", 1): 1.0, ("b", 1): 4.0}
    with pytest.raises(ValueError, match="repeats = 0 is outside the accepted range 1 to 1000"):
        speed.run_speed(None, repeats=0)
