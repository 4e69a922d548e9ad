"""What takes long for a reason that is not seen is said."""

from numba import njit

from agents.terminal.notices import said_when_compiling


def test_compiling_is_said_once_and_what_is_compiled_already_says_nothing(capsys):
    first, second = (njit(lambda x, k=k: x + k) for k in (1.0, 2.0))
    with said_when_compiling():
        assert first(1.0) + second(1.0) == 5.0
    assert capsys.readouterr().err == "compiling kernels, which are kept for later runs\n"
    with said_when_compiling():
        assert first(1.0) + second(1.0) == 5.0
    assert capsys.readouterr().err == ""
