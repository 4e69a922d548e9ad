"""The files of other commits beside this checkout, so that their code can be run.

A commit is checked out once, and compiles its kernels once; where its simulator is the same it gets those of this
checkout.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Final

from agents.publishing.stages import WORK, Stage
from agents.records.provenance import CHECKOUT
from probe_env.kernel_cache import STAMP

KERNELS: Final = Path("probe_env/physics")
STATES: Final = """
import json
from agents.publishing.stages import load_stages
print(json.dumps({stage.name: stage.state() for stage in load_stages()}))
"""

BY_TODAY: Final = """
import importlib.util, json, sys
def load(name, path):
    spec = importlib.util.spec_from_file_location(name, path)
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]
here = sys.argv[1]
load("agents.records.code_hash", f"{here}/agents/records/code_hash.py")
today = load("agents.publishing.stages", f"{here}/agents/publishing/stages.py")
stages = today.Stages.from_toml(f"{here}/configs/results.toml").stage
states = {}
for stage in stages:
    try:
        states[stage.name] = stage.state()
    except (KeyError, ValueError):  # its code, or its method, was not there yet
        continue
print(json.dumps(states))
"""


@contextmanager
def checked_out_once() -> Iterator[Callable[[str], Path]]:
    """The files of commits by name; each is checked out once, so that its kernels are compiled once."""
    known: dict[str, Path] = {}
    with ExitStack() as stack:

        def tree_of(name: str) -> Path:
            if name not in known:
                known[name] = stack.enter_context(checked_out(name))
                share_compiled(known[name])
            return known[name]

        yield tree_of


@contextmanager
def checked_out(name: str) -> Iterator[Path]:
    """The files of a commit, in a folder of their own while it is entered."""
    tree = WORK / f"tree-{name}"
    git = ["git", "-C", str(CHECKOUT), "worktree"]
    subprocess.run([*git, "remove", "--force", str(tree)], check=False, capture_output=True)
    subprocess.run([*git, "add", "--detach", str(tree), name], check=True, capture_output=True)
    try:
        yield tree
    finally:
        subprocess.run([*git, "remove", "--force", str(tree)], check=True, capture_output=True)


@cache
def states_in(tree: Path) -> dict[str, dict[str, str]]:
    """Stage -> what its results depended on, with the code and configuration in a tree; empty where it cannot tell."""
    return _printed_json(tree, STATES)


@cache
def states_by_today(tree: Path) -> dict[str, dict[str, str]]:
    """Stage -> what its results depend on by today's list of stages and today's hash, of the files of a tree.

    Without stages whose code was not there yet; empty where a tree is too old to be looked at so.
    """
    return _printed_json(tree, BY_TODAY, str(CHECKOUT))


def _printed_json(tree: Path, script: str, *arguments: str) -> dict[str, dict[str, str]]:
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], cwd=tree, env=os.environ | {"PYTHONPATH": str(tree)},
        check=False, capture_output=True, text=True,
    )  # fmt: skip
    return {} if done.returncode else dict(json.loads(done.stdout.splitlines()[-1]))


def share_compiled(tree: Path) -> None:
    """Give a tree the compiled kernels that are here, where its simulator is the same to the last byte."""
    here, there = CHECKOUT / KERNELS, tree / KERNELS
    sources = sorted(here.rglob("*.py"))
    if [path.relative_to(here) for path in sources] != sorted(path.relative_to(there) for path in there.rglob("*.py")):
        return
    if all(path.read_bytes() == (there / path.relative_to(here)).read_bytes() for path in sources):
        for path in (*here.rglob("*.nb[ic]"), *here.rglob(STAMP)):
            target = there / path.relative_to(here)
            target.parent.mkdir(exist_ok=True)
            shutil.copyfile(path, target)


def put_inputs(stage: Stage, tree: Path) -> None:
    """Put the stage's inputs, as they are here, in the place of those of a tree, where they may have another folder.

    Raises:
        RuntimeError: a file has no place there, or several.
    """
    for path in sorted(path for pattern in stage.reads for path in CHECKOUT.glob(pattern)):
        places = [tree / path.relative_to(CHECKOUT)]
        if not places[0].exists():
            places = [place for place in tree.rglob(path.name) if place.is_file()]
        if len(places) != 1:
            raise RuntimeError(f"stage {stage.name}: {path.name} has {len(places)} places in {tree}")
        shutil.copyfile(path, places[0])
