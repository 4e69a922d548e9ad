"""The ``probe-env`` command: errors and interrupts as one line, subcommands from ``agents.commands``."""

# the packages behind the commands take seconds to load, during which interrupts must be heard: they are loaded in _run
from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

from agents.processes.interrupts import heard, tell


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``probe-env``; returns the exit status."""
    if arguments is None:  # a process of its own, in which numpy is not loaded yet
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only wait for each other
    with heard(own=arguments is None):
        try:
            return _run(sys.argv[1:] if arguments is None else list(arguments))
        except KeyboardInterrupt as error:
            return tell(error)
        except BrokenPipeError:  # whoever read what is printed has enough, as head does
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left goes nowhere
            return 1


def _run(arguments: Sequence[str]) -> int:
    from agents.commands.registry import COMMANDS, first_page

    name = arguments[0] if arguments else ""
    if name in ("", "-h", "--help"):
        print(first_page())
        return 0 if name else 2
    if name == "--version":
        from importlib.metadata import version

        print(f"probe-env {version('probe-env')}")
        return 0
    if name not in COMMANDS:
        return _fail(f"command = {name!r} is not one of {', '.join(COMMANDS)}; probe-env --help tells what they do")
    return _run_command(name, arguments[1:])


def _run_command(name: str, arguments: Sequence[str]) -> int:
    import warnings

    from agents.terminal.extras import extra_with
    from agents.terminal.refusals import refusal
    from probe_env import SimulationError

    try:
        from agents.terminal.masking import masked
        from agents.terminal.notices import said_when_compiling
        from probe_env.files import one_line

        warnings.formatwarning = lambda message, *_, **__: f"probe-env: warning: {one_line(masked(str(message)))}\n"
        _show_choices()
        command = _command(name, arguments)
        with said_when_compiling():
            command.run()
    except ImportError as error:
        module = _missing(error)
        extra = extra_with(module)
        if extra is None:
            raise
        return _fail(f'this command needs {module}, which is not installed: pip install "probe-env[{extra}]"')
    except BrokenPipeError:
        raise
    except (ValueError, OSError, SimulationError, RuntimeError) as error:
        return _fail(refusal(error))
    return 0


def _missing(error: ImportError) -> str:
    """The module that an import did not find; Stable-Baselines3 tells it in words that begin with the name alone."""
    return (error.name or str(error)).replace(".", " ").partition(" ")[0]


def _show_choices() -> None:
    """Print what "auto" picks and why, and how much there is to do."""
    import logging

    logger = logging.getLogger("probe_env")
    logger.handlers = [logging.StreamHandler(sys.stderr)]
    logger.setLevel(logging.INFO)


def _command(name: str, arguments: Sequence[str]) -> Any:
    """The command with its arguments; the scene that is named gives the defaults of --scene options."""
    from importlib import import_module

    from agents.commands.registry import COMMANDS
    from agents.terminal.command_line import parsed, positional

    module, _, kind = COMMANDS[name].place.partition(":")
    command_class = getattr(import_module(f"agents.commands.{module}"), kind)
    default = command_class.of_scene(positional(arguments)) if hasattr(command_class, "of_scene") else None
    return parsed(name, command_class, arguments, COMMANDS[name].example, default)


def _fail(message: str, status: int = 2) -> int:
    import re

    from agents.terminal.masking import masked
    from probe_env.files import one_line

    whole = re.sub(r"(\w:)/(?=[^/\s]*:[^/\s]*@)", r"\1//", message)  # an address that was taken for a path lost a slash
    print(f"probe-env: error: {one_line(masked(whole))}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
