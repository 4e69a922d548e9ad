"""Where a stored result comes from: versions, commit, machine and command."""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from agents.records.atomic import write_atomically as write_atomically
from probe_env.machine import available_cores

CHECKOUT = Path(__file__).parents[2]
CODE = ("probe_env", "agents", "configs", "pyproject.toml", "constraints.txt")
"""What a result depends on: changes of anything else do not make a commit unclean."""
DATA = ("probe_env/data", "agents/policies/data", "agents/plant/data", "configs/tubes/*-map.*")
"""Results that ship with the packages, each with its own provenance."""
STAGE_VARIABLE = "PROBE_ENV_STAGE"
"""Environment variable that names the stage of `probe-env results` that a command is run for."""
PACKAGES = ("probe-env", "numpy", "scipy", "numba", "pydantic")


def provenance(command: str | None = None, commits: Iterable[str] | None = None) -> dict[str, Any]:
    """Versions, commit, machine and command as a JSON-ready dictionary.

    Args:
        command: default: that of this process.
        commits: of the rows that a table holds; default: the present one.
    """
    stage = os.environ.get(STAGE_VARIABLE)
    return ({"stage": stage} if stage else {}) | {
        "command": command or "probe-env " + shlex.join(sys.argv[1:]),
        "commit": ", ".join(dict.fromkeys(commits if commits is not None else [commit()])),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
        "machine": {
            "processor": _processor(),
            "cores": available_cores(),
            "system": f"{platform.system()} {platform.machine()}",
            "kernels": _kernels(),
        },
    }


def _kernels() -> str:
    """What linear algebra and numba choose code for: it decides the last digits, and in chaos all that follows.

    Processors of one name need not agree, and environment variables change both.
    """
    from llvmlite.binding import get_host_cpu_name
    from threadpoolctl import threadpool_info

    blas = {
        f"{pool['internal_api']} {pool.get('architecture', '')}"
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    }
    target = os.environ.get("NUMBA_CPU_NAME") or get_host_cpu_name()
    return ", ".join([*sorted(blas), f"numba {target}"])


@lru_cache
def commit() -> str:
    """Commit of the checkout as this process began, marked if code or configuration differs; "unknown" outside one."""
    head = _git("rev-parse", "--short=12", "HEAD")
    if head is None:
        return "unknown"
    return head + ("+changes" if changed_code() else "")


@lru_cache
def changed_code() -> tuple[str, ...]:
    """Files of code and configuration that differ from the commit, new ones included, as this process began."""
    excluded = (f":(exclude){folder}" for folder in DATA)
    listed = _git("status", "--porcelain", "--untracked-files=all", "--", *CODE, *excluded)
    return tuple(line[3:] for line in (listed or "").splitlines())


def committed_at(name: str) -> int:
    """When a commit of this history was made [s since 1970]."""
    git = ["git", "-C", str(CHECKOUT), "show", "--no-patch", "--format=%ct", name]
    return int(subprocess.run(git, check=True, capture_output=True, text=True).stdout.split()[-1])


def in_history(name: str) -> bool:
    """Whether a stored commit is a clean one of this checkout's history."""
    return _git("merge-base", "--is-ancestor", name, "HEAD") is not None


def _git(*arguments: str) -> str | None:
    """What git prints in the checkout; None where it fails or is not there."""
    if not (CHECKOUT / ".git").exists():  # an installed package may stand in a repository of somebody else's
        return None
    try:
        done = subprocess.run(["git", *arguments], cwd=CHECKOUT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.rstrip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def write_json(path: Path, data: Any) -> None:
    """Write JSON atomically; NaN becomes null."""
    write_atomically(path, json.dumps(_plain(data), indent=2, allow_nan=False) + "\n")


def _plain(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float) and data != data:
        return None
    return data
