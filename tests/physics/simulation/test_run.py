"""Tables, plots and progress of a run."""

import numpy as np
import pytest

from probe_env import Scene, Simulator

SCENE = Scene(carrier_length=1.0)
RUN = Simulator(SCENE, "imex", 2e-4).run(0.05, points=("sensor", 0.2))


def test_tables_and_plots_hold_the_signals_with_their_units():
    frame = RUN.to_pandas()
    assert frame.index.name == "time_s"
    assert list(frame["sensor"]) == ["axial_m", "radial_m", "rotation_rad", "tension_n"]
    for k, point in enumerate(RUN.points):
        assert (frame[point, "radial_m"].to_numpy() == RUN.radial[:, k]).all()
        assert (frame[point, "tension_n"].to_numpy() == RUN.tension[:, k]).all()
    summary = RUN.summary()
    assert list(summary.index) == ["sensor", "0.2 m"]
    assert summary.loc["0.2 m", "axial_m_rms"] == pytest.approx(RUN.axial[:, 1].std(), rel=1e-12)
    assert summary.loc["sensor", "tension_n_max"] == np.abs(RUN.tension[:, 0]).max()
    axes = RUN.plot("tension")
    assert [line.get_label() for line in axes.lines] == ["sensor", "0.2 m"]
    assert axes.get_ylabel() == "tension [N]"
    with pytest.raises(ValueError, match="quantity = 'force' is not one of axial, radial, rotation, tension"):
        RUN.plot("force")


def test_progress_is_a_bar_or_a_function(capsys):
    times = []
    Simulator(SCENE, "imex", 2e-4).run(0.9, progress=times.append)
    assert times[-1] == pytest.approx(0.9)
    assert len(times) == 3  # calls of 2000 steps
    assert capsys.readouterr().err == ""
    Simulator(SCENE, "imex", 2e-4).run(0.1, progress=True)
    assert "100%" in capsys.readouterr().err
