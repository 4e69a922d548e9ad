"""The ``probe-env`` command: errors as one line, subcommands from ``agents.commands``."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Union

import tyro
from pydantic import ValidationError

from agents.commands.design import Compare, DesignSearch
from agents.commands.feed import Evaluate, Map, Optimise, Render, Report, Tradeoff, Train
from agents.commands.results import Results
from agents.commands.study import Bench, Chart, Peers, Scaling, Simulate, Stability, Study, Timelapse
from agents.publishing import in_its_place
from probe_env import Scene, SimulationError
from probe_env.scene import explain


@dataclass(frozen=True)
class Readme:
    """Rewrite the README's tables and figures from the stored results."""

    check: bool = False
    """Change nothing; fail if the README is not what the stored results say."""

    def run(self) -> None:
        """Rewrite or check."""
        from agents.readme import check_readme, rewrite_readme

        check_readme() if self.check else rewrite_readme()


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``probe-env``; returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        warnings.formatwarning = lambda message, *_, **__: f"probe-env: warning: {message}\n"
        _show_choices()
        command = tyro.cli(_commands(arguments), args=arguments, prog="probe-env", description=__doc__)
        in_its_place(command).run()
    except ValidationError as error:
        return _fail(explain(error))
    except FileNotFoundError as error:
        return _fail(f"no such file: {error.filename}")
    except (ValueError, OSError, SimulationError, RuntimeError) as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return _fail("interrupted; what was finished is stored", 130)
    return 0


def _show_choices() -> None:
    """Print what "auto" picks and why."""
    logger = logging.getLogger("probe_env")
    if not logger.handlers:
        logger.addHandler(logging.StreamHandler(sys.stderr))
        logger.setLevel(logging.INFO)


def _commands(arguments: Sequence[str]) -> Any:
    """The subcommands; the scene file named on the command line gives the defaults of --scene options."""
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
    print(f"probe-env: error: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
