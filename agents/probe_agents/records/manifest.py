"""Writes ``manifest.json`` of a result: command, commit, versions, machine and hashes of its files."""

import hashlib
import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from probe_agents.records.atomic import write_atomically
from probe_env.machine import available_cores

CHECKOUT: Final = Path(__file__).parents[3]
CODE: Final = ("probe_env", "agents", "pyproject.toml", "constraints.txt")
"""Files of the code: only their commits and changes count. What a result takes from ``configs`` is stored with it."""
DATA: Final = ("probe_env/data", "agents/probe_agents/policies/data", "agents/probe_agents/plant/data")
"""Shipped results: studies write them, which is no change of the code."""
CHANGED: Final = "+changes"
PACKAGES: Final = ("probe-env", "numpy", "scipy", "numba", "pydantic")


def write_manifest(
    folder: Path,
    files: Iterable[str] = (),
    *,
    seeds: Iterable[int] = (),
    command: str | None = None,
    commits: Iterable[str] | None = None,
    **settings: Any,
) -> None:
    """Write the manifest of a result, after its files.

    Args:
        folder: folder of the result.
        files: names relative to the folder; the SHA-256 of each is stored.
        seeds: seeds of the result.
        command: command line; default: the one of this process.
        commits: commits of the rows in its tables; default: the present one.
        settings: further fields, JSON-ready.
    """
    hashes = {file: hashlib.sha256((folder / file).read_bytes()).hexdigest() for file in files}
    write_json(folder / "manifest.json", origin(command, commits) | {"seeds": list(seeds), "files": hashes} | settings)


def origin(command: str | None = None, commits: Iterable[str] | None = None) -> dict[str, Any]:
    """Command, version, commit, packages and machine, JSON-ready; arguments as in ``write_manifest``."""
    names = list(dict.fromkeys(commits if commits is not None else [commit()]))
    has_commits = bool(names) and "unknown" not in names
    return {
        "command": PASSWORD.sub(r"\1:***@", command or "probe-env " + shlex.join(sys.argv[1:])),
        "version": version("probe-env"),
        "commit": ", ".join(names),
        "clean": not any(name.endswith(CHANGED) for name in names) if has_commits else None,
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
    """Instruction sets of linear algebra and numba, which determine the last digits of results.

    They can differ between processors of one name, and environment variables change both.
    """
    from llvmlite.binding import get_host_cpu_name
    from threadpoolctl import threadpool_info

    pools = (pool for pool in threadpool_info() if pool["user_api"] == "blas")
    blas = {f"{pool['internal_api']} {pool.get('architecture', '')}" for pool in pools}
    target = os.environ.get("NUMBA_CPU_NAME") or get_host_cpu_name()
    return ", ".join([*sorted(blas), f"numba {target}"])


PASSWORD: Final = re.compile(r"(://[^:/?#@\s]*):\S*@")
"""Password in a URL, such as the address of a cluster; it is not stored."""


@lru_cache
def commit() -> str:
    """Last commit of the code at the start of this process, marked if files differ; "unknown" without a checkout."""
    last = _git("log", "-1", "--format=%h", "--abbrev=12", "--", *CODE)
    if not last:
        return "unknown"
    excluded = (f":(exclude){folder}" for folder in DATA)
    return last + (CHANGED if _git("status", "--porcelain", "--untracked-files=all", "--", *CODE, *excluded) else "")


def _git(*arguments: str) -> str | None:
    if not (CHECKOUT / ".git").exists():  # an installed package can be inside another repository
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
    """Write JSON atomically; NaN becomes null, characters that are not UTF-8 escapes."""
    write_atomically(path, json.dumps(_plain(data), indent=2, allow_nan=False) + "\n")


def _plain(data: Any) -> Any:
    if isinstance(data, str):
        return data.encode("utf-8", "backslashreplace").decode()  # names of files that are not UTF-8
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    return None if isinstance(data, float) and data != data else data
