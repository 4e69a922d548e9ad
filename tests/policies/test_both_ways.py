"""The fidelity of both passes without time-lapse, and the warning of what time-lapse does there."""

import warnings

import pytest

from agents.policies.both_ways import UNLAPSED, fidelity_of, warn_of_time_lapse


def test_unlapsed_is_fast_without_its_time_lapse():
    usual, without = fidelity_of("fast"), fidelity_of(UNLAPSED)
    assert (usual.time_lapse, without.time_lapse) == (4.0, 1.0)
    assert without.model_copy(update={"time_lapse": 4.0}) == usual
    assert fidelity_of("reference-v0").method == "imex"
    refused = "'reference' does not simulate the way back; give one of standard, fast, unlapsed, study, reference-v0"
    with pytest.raises(ValueError, match=refused):
        fidelity_of("reference")


def test_time_lapse_is_warned_of_and_nothing_else():
    with pytest.warns(UserWarning, match="time_lapse = 4: the turn shakes the probe over so many times as many metres"):
        warn_of_time_lapse(fidelity_of("fast"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in (UNLAPSED, "standard", "study"):
            warn_of_time_lapse(fidelity_of(name))
