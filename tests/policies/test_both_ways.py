"""Fidelities of both passes by their names."""

import pytest

from agents.policies.both_ways import fidelity_of


def test_presets_of_round_trips_and_refusals():
    assert (fidelity_of("fast").method, fidelity_of("fast").time_lapse) == ("imex", 4.0)
    assert fidelity_of("standard").nodes_per_pitch == 8
    refused = "'reference' does not simulate the way back; give one of standard, fast, study$"
    with pytest.raises(ValueError, match=refused):
        fidelity_of("reference")
    with pytest.raises(ValueError, match="'surrogate' does not simulate the way back"):
        fidelity_of("surrogate")
