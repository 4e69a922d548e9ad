"""Designs that are judged by what is found."""

from dataclasses import replace

import numpy as np
import pytest

from probe_env import Context, Design, Fidelity
from probe_env.envs.task import FAILURES, TaskConfig
from probe_env.envs.trials import Candidate, check_measure, judge, try_sections
from probe_env.schedule import Schedule

SNR = TaskConfig(vibration_measure="snr", vibration_weight=4.0)
FEED = Schedule("inserted_length", "linear", (5.0, 60.0), (0.2, 0.2), (63.0 / 3600.0,) * 2)
ORIGINAL = Design.from_toml("configs/design/original.toml")
FAST = Fidelity(method="superelement32", time_step=2e-4)


@pytest.fixture(scope="module")
def tried():
    """One design in a rough and a smooth tube, in both measures."""
    candidates = [Candidate(ORIGINAL, Context(friction=mu, helix_diameter=1.2), FEED) for mu in (0.1, 0.25)]
    return try_sections(candidates, SNR, FAST), try_sections(candidates, TaskConfig(), FAST)


@pytest.mark.processor
def test_the_quiet_first_metres_have_the_anchor_s_signal_to_noise(tried):
    """7.5 for a 20 % groove at 0.2 m/s in a smooth tube; motion only adds: S/N is below 3 where it rings."""
    noisy, _ = tried
    quiet, loud = 1.0 / SNR.sensor.quiet_snr, 1.0 / SNR.sensor.shaken_snr
    assert (noisy.noise >= quiet * (1.0 - 1e-6)).all()
    assert noisy.noise[0, 0] == pytest.approx(quiet, rel=0.02)  # some um of rms, where 0.1 mm make it 2.5 times as much
    assert noisy.noise[1].max() > loud
    assert (noisy.radial_rms[noisy.noise > loud] > 5e-5).all()  # 0.1 mm in the band do it, and half is in the band


def test_nothing_but_the_measure_differs(tried):
    noisy, plain = tried
    assert plain.noise is None
    for name in ("widths", "feed_speed", "radial_rms", "root_tension"):
        assert (getattr(noisy, name) == getattr(plain, name)).all(), name
    assert all((noisy.failed[name] == plain.failed[name]).all() for name in FAILURES)


def test_the_reward_counts_noise_over_signal(tried):
    """A metre at the limit, S/N 3, costs its weight; half of the noise a quarter of it."""
    noisy, _ = tried
    designs, span = [ORIGINAL, ORIGINAL], noisy.widths.sum(axis=1)
    for share in (1.0, 0.5):
        same = replace(noisy, noise=np.full_like(noisy.noise, share / 3.0))
        terms, kpis = judge(designs, same, SNR)
        assert terms["vibration"] == pytest.approx(-4.0 * share**2 * span, rel=1e-9)
        assert kpis["share_within_limit"] == pytest.approx(1.0, abs=1e-9)


def test_other_measures_are_refused():
    with pytest.raises(ValueError, match="vibration_measure = 'velocity': designs are judged by displacement or snr"):
        check_measure(TaskConfig(vibration_measure="velocity"))
