"""The ``probe-env`` command: errors and interrupts end it with one line.

The packages of the commands take seconds to load; they are loaded after the signal handlers are set.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

from agents.cli.interrupts import report, signal_handlers


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``probe-env``; returns the exit status."""
    if arguments is None:  # a process of its own, in which numpy is not loaded yet
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only wait for each other
    with signal_handlers():
        try:
            return _run(sys.argv[1:] if arguments is None else list(arguments))
        except KeyboardInterrupt as error:
            return report(error)
        except BrokenPipeError:  # the reader of a pipe, such as head, has ended
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left goes nowhere
            return 1


def _run(arguments: Sequence[str]) -> int:
    from agents.cli.registry import COMMANDS, first_page

    name = arguments[0] if arguments else ""
    if name in ("", "-h", "--help"):
        print(first_page())
        return 0 if name else 2
    if name == "--version":
        from importlib.metadata import version

        print(f"probe-env {version('probe-env')}")
        return 0
    if name not in COMMANDS:
        return _fail(f"command = {name!r} is not one of {', '.join(COMMANDS)}; see probe-env --help")
    from agents.cli.extras import extra_with
    from agents.terminal.refusals import refusal
    from probe_env import SimulationError

    try:
        _run_command(name, arguments[1:])
    except ImportError as error:
        # the message of Stable-Baselines3 begins with the name of the module
        module = (error.name or str(error)).replace(".", " ").partition(" ")[0]
        extra = extra_with(module)
        if extra is None:
            raise
        return _fail(f'this command needs {module}, which is not installed: pip install "probe-env[{extra}]"')
    except BrokenPipeError:
        raise
    except (ValueError, OSError, SimulationError, RuntimeError) as error:
        return _fail(refusal(error))
    return 0


def _run_command(name: str, arguments: Sequence[str]) -> None:
    import logging
    import warnings
    from importlib import import_module

    from agents.cli.parsing import parsed, positional
    from agents.cli.registry import COMMANDS
    from agents.terminal.notices import said_when_compiling
    from probe_env.files import one_line

    warnings.formatwarning = lambda message, *_, **__: f"probe-env: warning: {one_line(str(message))}\n"
    logger = logging.getLogger("probe_env")  # what "auto" picks and why, and how much there is to do
    logger.handlers = [logging.StreamHandler(sys.stderr)]
    logger.setLevel(logging.INFO)
    module, _, kind = COMMANDS[name][0].partition(":")
    command_class: Any = getattr(import_module(f"agents.cli.{module}"), kind)
    default = command_class.of_scene(positional(arguments)) if hasattr(command_class, "of_scene") else None
    command = parsed(name, command_class, arguments, default)
    with said_when_compiling():
        command.run()


def _fail(message: str) -> int:
    from probe_env.files import one_line

    print(f"probe-env: error: {one_line(message)}", file=sys.stderr)
    return 2
