"""The ``probe-env`` command: errors and interrupts as one line, subcommands from ``agents.commands``."""

# the packages behind the commands take seconds to load, during which interrupts must be heard: they are loaded in _run
from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from agents.processes.interrupts import heard, tell


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``probe-env``; returns the exit status."""
    with heard(own=arguments is None):
        try:
            return _run(sys.argv[1:] if arguments is None else list(arguments))
        except KeyboardInterrupt as error:
            return tell(error)


def _run(arguments: Sequence[str]) -> int:
    import warnings

    from pydantic import ValidationError

    from agents.publishing.places import in_its_place
    from agents.terminal.command_line import parsed
    from agents.terminal.notices import said_when_compiling
    from probe_env import SimulationError
    from probe_env.settings import explain

    try:
        warnings.formatwarning = lambda message, *_, **__: f"probe-env: warning: {message}\n"
        _show_choices()
        command = parsed(_commands(arguments), arguments, __doc__)
        with said_when_compiling():
            in_its_place(command).run()
    except ValidationError as error:
        return _fail(explain(error))
    except FileNotFoundError as error:
        return _fail(f"no such file: {error.filename}")
    except (ValueError, OSError, SimulationError, RuntimeError) as error:
        return _fail(str(error))
    return 0


def _show_choices() -> None:
    """Print what "auto" picks and why, and how much there is to do."""
    import logging

    logger = logging.getLogger("probe_env")
    logger.handlers = [logging.StreamHandler(sys.stderr)]
    logger.setLevel(logging.INFO)


def _commands(arguments: Sequence[str]) -> Any:
    """The subcommands; the scene file named on the command line gives the defaults of --scene options."""
    from pathlib import Path
    from typing import Annotated, Union

    import tyro

    from agents.commands.design import Compare, DesignSearch
    from agents.commands.feed import Evaluate, Map, Optimise, Render, Report, Tradeoff, Train
    from agents.commands.readme import Readme
    from agents.commands.results import Results
    from agents.commands.study import Bench, Chart, Peers, Scaling, Simulate, Stability, Study, Timelapse
    from probe_env import Scene

    simulate = tyro.conf.subcommand("simulate")
    if arguments[:1] == ["simulate"]:
        files = [argument for argument in arguments[1:] if argument.endswith(".toml")]
        if files:
            simulate = tyro.conf.subcommand("simulate", default=Simulate(Path(files[0]), Scene.from_toml(files[0])))
    others = (
        Annotated[kind, tyro.conf.subcommand(name)]
        for name, kind in (
            ("study", Study),
            ("chart", Chart),
            ("peers", Peers),
            ("bench", Bench),
            ("scaling", Scaling),
            ("timelapse", Timelapse),
            ("stability", Stability),
            ("render", Render),
            ("evaluate", Evaluate),
            ("report", Report),
            ("tradeoff", Tradeoff),
            ("map", Map),
            ("optimise", Optimise),
            ("train", Train),
            ("compare", Compare),
            ("design", DesignSearch),
            ("results", Results),
            ("readme", Readme),
        )
    )
    return Union[Annotated[Simulate, simulate], *others]


def _fail(message: str, status: int = 2) -> int:
    from probe_env.files import one_line

    print(f"probe-env: error: {one_line(message)}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
