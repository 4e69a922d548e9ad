"""The ``probe-env`` command: an error or an interrupt ends it with one line.

The packages of the commands take seconds to load; they are loaded after the signal handlers are set.
"""

import os
import sys
from collections.abc import Sequence
from typing import Any

from probe_agents.cli.interrupts import report, signal_handlers


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``probe-env``; returns the exit status."""
    if arguments is None:  # the command itself, before numpy is loaded
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are too small for threads
        os.environ["MPLBACKEND"] = "agg"  # a notebook passes on its own, which may not be installed here
    _open_closed_streams()
    with signal_handlers():
        try:
            return _run(sys.argv[1:] if arguments is None else list(arguments))
        except KeyboardInterrupt as error:
            return report(error)
        except BrokenPipeError:  # the reader of the pipe, such as head, has ended
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # discard further output
            return 1


def _open_closed_streams() -> None:
    """Discard output to streams that the caller has closed: progress must not end the work, nor go into its files."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, "w", closefd=False))


def _run(arguments: Sequence[str]) -> int:
    import logging
    import warnings
    from difflib import get_close_matches
    from importlib import import_module

    from probe_agents.cli.registry import COMMANDS, NEEDS, extra_with, first_page

    name = arguments[0] if arguments else ""
    if name in ("", "-h", "--help"):
        print(first_page())
        return 0 if name else 2
    if name == "--version":
        from importlib.metadata import version

        print(f"probe-env {version('probe-env')}")
        return 0
    if name not in COMMANDS:
        closest = get_close_matches(name, COMMANDS, n=1)
        hint = f"did you mean {closest[0]}?" if closest else f"the commands are {', '.join(COMMANDS)}."
        return _fail(f"there is no command {name!r}: {hint} See probe-env --help")
    from probe_agents.terminal.messages import format_error
    from probe_env import SimulationError
    from probe_env.files import one_line

    warnings.formatwarning = lambda message, *_, **__: f"probe-env: warning: {one_line(str(message))}\n"
    logger = logging.getLogger("probe_env")  # the choice of "auto", and the remaining work
    logger.handlers = [logging.StreamHandler(sys.stderr)]
    logger.setLevel(logging.INFO)
    try:
        from probe_agents.cli.parsing import parse, positional
        from probe_agents.terminal.messages import announce_compilation

        module, _, kind = COMMANDS[name][0].partition(":")
        command_class: Any = getattr(import_module(f"probe_agents.cli.{module}"), kind)
        default = command_class.of_scene(positional(arguments[1:])) if hasattr(command_class, "of_scene") else None
        command = parse(name, command_class, arguments[1:], default)
        with announce_compilation():
            command.run()
    except ImportError as error:
        # the message of Stable-Baselines3 begins with the name of the module
        module = (error.name or str(error)).replace(".", " ").partition(" ")[0]
        extra = extra_with(module, NEEDS.get(name, "commands"))
        if extra is None:
            raise
        return _fail(f'{name} needs {module}, which is not installed: pip install "probe-env[{extra}]"')
    except BrokenPipeError:
        raise
    except (ValueError, OSError, SimulationError, RuntimeError, MemoryError) as error:
        return _fail(format_error(error))
    return 0


def _fail(message: str) -> int:
    from probe_env.files import one_line

    print(f"probe-env: error: {one_line(message)}", file=sys.stderr)
    return 2
