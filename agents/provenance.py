"""Where a stored result comes from: versions, commit, machine, command, and a hash of the kernels."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import platform
import shlex
import subprocess
import sys
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import probe_env
from agents.atomic import write_atomically as write_atomically

COMMON_SOURCES = ("chain.py", "drive.py")
STUDY_SOURCES = ("schemes.py", "ticm.py")
IMPLICIT_SOURCES = (*STUDY_SOURCES, "implicit.py", "linear_part.py")
LANE_SOURCES = ("imex.py", "lane_group.py", "lanes.py", "linear_part.py", "single_precision.py")
KERNEL_SOURCES = {
    "newmark": STUDY_SOURCES,
    "wilson": STUDY_SOURCES,
    "implicit": IMPLICIT_SOURCES,
    "imex": LANE_SOURCES,
    "imex32": LANE_SOURCES,
    "explicit": LANE_SOURCES,
}
PACKAGES = ("probe-env", "numpy", "scipy", "numba", "pydantic")


def provenance(command: str | None = None) -> dict[str, Any]:
    """Versions, commit, machine and command as a JSON-ready dictionary."""
    return {
        "command": command or "probe-env " + shlex.join(sys.argv[1:]),
        "commit": commit(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
        "machine": {
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0)),
            "system": f"{platform.system()} {platform.machine()}",
        },
    }


@lru_cache
def kernel_hash(method: str) -> str:
    """Short hash of the code that a method's results depend on, so that stored results show when they are old.

    Comments, docstrings and layout do not count. Call it from one thread only: CPython 3.11 cannot parse in two.
    """
    digest = hashlib.sha256()
    folder = Path(probe_env.__file__).parent
    for name in (*COMMON_SOURCES, *KERNEL_SOURCES[method]):
        tree = ast.parse((folder / name).read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
                node.body = node.body[1:]
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:16]


def commit() -> str:
    """Commit of the checkout, with a mark if it has changes; "unknown" outside a checkout."""
    folder = Path(__file__).parent
    try:
        head = subprocess.run(
            ["git", "rev-parse", "--short=12", "HEAD"], cwd=folder, capture_output=True, text=True, check=True
        ).stdout.strip()
        changed = subprocess.run(
            ["git", "status", "--porcelain", "-uno"], cwd=folder, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head + ("+changes" if changed else "")


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
