"""A fidelity on the command line: a name, or what an error advises."""

import re

import pytest

from agents.terminal.fidelities import fidelity_given
from probe_env import Fidelity
from probe_env.fidelity import resolve_fidelity

OWN = Fidelity(method="superelement32", time_step=1e-4, time_lapse=4.0)


def test_names_stay_and_settings_are_read_as_errors_write_them():
    assert fidelity_given("fast") == "fast"
    assert resolve_fidelity(fidelity_given(str(OWN.model_dump()))) == OWN
    assert fidelity_given(" {'method': 'imex'}") == Fidelity(method="imex")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{'method'", "fidelity = \"{'method'\" is neither a name nor settings"),
        ("{'method': open('x')}", "is neither a name nor settings"),
        ("{'methd': 'imex'}", "fidelity.methd: there is no such field; accepted: method, time_step"),
        ("{'method': 'euler'}", "fidelity.method"),
    ],
)
def test_what_is_neither_is_refused(text, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        fidelity_given(text)
