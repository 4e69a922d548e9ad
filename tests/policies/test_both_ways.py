"""Fidelities of both passes by their names."""

import pytest

from agents.policies.wrappers import fidelity_of


def test_unlapsed_is_fast_without_its_time_lapse():
    usual, without = fidelity_of("fast"), fidelity_of("unlapsed")
    assert (usual.time_lapse, without.time_lapse) == (4.0, 1.0)
    assert without.model_copy(update={"time_lapse": 4.0}) == usual
    assert fidelity_of("reference-v0").method == "imex"
    refused = "'reference' does not simulate the way back; give one of standard, unlapsed, fast, study, reference-v0"
    with pytest.raises(ValueError, match=refused):
        fidelity_of("reference")
