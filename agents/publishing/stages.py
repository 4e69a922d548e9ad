"""Everything published, made again in order from one clean commit: what is stale, how long it takes, and the runs.

``configs/results.toml`` lists the stages. A stage works in a folder of its own, named after its code, inputs and
command, so what was interrupted goes on and nothing is mixed; when it is done, its files take the place of the
published ones and ``results/records/STAGE.json`` says what made them.
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Final

import pandas as pd
from pydantic import Field

from agents.records.code_hash import ALL, code_hash
from agents.records.models import Record
from agents.records.provenance import (
    CHECKOUT,
    STAGE_VARIABLE,
    changed_code,
    commit,
    in_history,
    provenance,
    write_atomically,
    write_json,
)
from agents.records.reading import FileError, read_json
from agents.terminal.tables import print_table
from probe_env.files import read_text
from probe_env.settings import Model

CONFIG: Final = CHECKOUT / "configs" / "results.toml"
RECORDS: Final = CHECKOUT / "results" / "records"
WORK: Final = CHECKOUT / "output" / "results"
OF_PLANTS_ALONE: Final = ("probe_env.envs.plants.plant:Plant.contexts",)
"""How tubes of a plant are drawn: every stage reaches it by its name, those of the shipped tubes never run it."""
OF_RETURN_ALONE: Final = (
    "probe_env.envs.task.passes:BothWays",
    "agents.policies.catalogue:_both_ways",
)
"""How both passes are judged, and who plays them: stages whose probes go one way reach it by name and never run it."""
APART: Final = ("commit", "code")
"""Columns that say where a row comes from, not what it says."""


class Stage(Model):
    """One command whose results are published.

    Attributes:
        name: of the stage.
        command: of ``probe-env``; ``{work}`` is the folder that it works in.
        publish: published folder -> patterns of the files in the work folder that go there.
        code: where the code that the results depend on begins, see ``code_hash``.
        method: of the simulation; "all": all methods count.
        plants: whether tubes are drawn of a plant; else how that is done does not count.
        returns: whether probes are drawn back; else how both passes are judged does not count.
        reads: patterns of files that the results depend on.
        script: makes a sample where no option of the command does; called with a folder, by both codes.
        sample: options of the command for a short run that shows whether changed code gives the same, see ``confirm``;
            ``{samples}`` is the folder of what only samples read.
        minutes: that it takes on two cores, before it has been measured here.
    """

    name: str
    command: str
    publish: dict[str, tuple[str, ...]]
    code: tuple[str, ...]
    method: str = ALL
    plants: bool = False
    returns: bool = False
    reads: tuple[str, ...] = ()
    script: str = ""
    sample: dict[str, str] = Field(default_factory=dict)
    minutes: Annotated[float, Field(gt=0.0)]

    def state(self) -> dict[str, str]:
        """What the results depend on."""
        files = {path for pattern in self.reads for path in CHECKOUT.glob(pattern)}
        contents = sorted(f"{path.name} {hashlib.sha256(content(path)).hexdigest()}\n" for path in files)
        inputs = hashlib.sha256("".join(contents).encode())  # blind to the folders that they are in
        never_run = (() if self.plants else OF_PLANTS_ALONE) + (() if self.returns else OF_RETURN_ALONE)
        code = code_hash(self.code, self.method, never_run)
        return {"command": self.command, "code": code, "inputs": inputs.hexdigest()[:16]}

    @property
    def work(self) -> Path:
        """The folder for just these code, inputs and command."""
        digest = hashlib.sha256(json.dumps(self.state(), sort_keys=True).encode()).hexdigest()[:8]
        return WORK / f"{self.name}-{digest}"

    def to_publish(self, work: Path) -> Iterator[tuple[str, str, list[Path]]]:
        """Published folder, pattern, and the files in a work folder that go there by it."""
        for folder, patterns in self.publish.items():
            for pattern in patterns:
                yield folder, pattern, [path for path in work.glob(pattern) if path.is_file()]

    def published(self) -> list[str]:
        """Patterns of the files that it publishes, from the checkout's folder."""
        return [f"{folder}/{pattern}" for folder, patterns in self.publish.items() for pattern in patterns]

    def record(self) -> dict[str, Any]:
        """What is known of the published results; empty if nothing."""
        path = RECORDS / f"{self.name}.json"
        return read_json(path, StageRecord).model_dump() if path.exists() else {}

    def stale(self) -> str:
        """Why the published results are not those of the present state; empty if they are."""
        record = self.record()
        if not record:
            return "never made"
        changed = [name for name, value in self.state().items() if record.get(name) != value]
        if changed:
            return f"{' and '.join(changed)} changed"
        if not in_history(record["commit"]):
            return f"commit {record['commit']} is not in the history"
        there = all((CHECKOUT / file).exists() for file in record["files"])
        return "" if there and all(any(CHECKOUT.glob(p)) for p in self.published()) else "files are missing"


def content(path: Path) -> bytes:
    """What a file says; of a store without the columns that say where its rows come from."""
    data = path.read_bytes()
    if path.suffix != ".csv" or "code" not in data.partition(b"\n")[0].decode().strip().split(","):
        return data
    return texts(path).drop(columns=list(APART), errors="ignore").to_csv().encode()


def texts(path: Path) -> pd.DataFrame:
    """A stored table, its cells as they are written.

    Raises:
        FileError: not a table.
    """
    try:
        return pd.read_csv(path, dtype=str)
    except (ValueError, pd.errors.ParserError) as error:
        raise FileError(path, f"not a CSV table: {error} - restore the file, or make it again") from error


class StageRecord(Record):
    """``results/records/STAGE.json``."""

    code: str
    inputs: str
    seconds: float
    files: tuple[str, ...]
    confirmed: tuple[dict[str, Any], ...] = ()
    """Changes of the code that a sample showed to change nothing."""


class Stages(Model):
    """The file's stages."""

    stage: tuple[Stage, ...]


def load_stages() -> tuple[Stage, ...]:
    """The stages in their order.

    Raises:
        ValueError: a stage stands before one whose results it reads, or twice.
    """
    stages = Stages.from_toml(CONFIG).stage
    for k, stage in enumerate(stages):
        late = sources(stage, stages[k:])
        if late:
            raise ValueError(
                f"{CONFIG.name}: stage {stage.name} reads what {', '.join(late)} makes, which must come first"
            )
        if stage.name in [other.name for other in stages[:k]]:
            raise ValueError(f"{CONFIG.name}: there are two stages {stage.name}")
    return stages


def sources(stage: Stage, stages: Sequence[Stage]) -> list[str]:
    """Names of those whose results a stage reads, by the patterns of what it reads and they publish."""
    there = {path.relative_to(CHECKOUT).as_posix() for pattern in stage.reads for path in CHECKOUT.glob(pattern)}

    def read(published: str) -> bool:
        return any(fnmatchcase(name, published) for name in (*there, *stage.reads))

    return [other.name for other in stages if other is not stage and any(map(read, other.published()))]


def run_results(names: Sequence[str], only_list: bool = False) -> None:
    """Make what is stale of the named stages (none: of all) and of those that they read, in order.

    Raises:
        ValueError: no such stage; or the code differs from the commit, and nothing was run.
        RuntimeError: a stage failed; those before it are published.
    """
    stages = load_stages()
    known = {stage.name: stage for stage in stages}
    for name in names:
        if name not in known:
            raise ValueError(f"stage = {name!r} is not one of {', '.join(known)}")
    wanted = _with_sources(names or list(known), known)
    todo = _print_plan([stage for stage in stages if stage.name in wanted])
    if only_list or not todo:
        return
    if not in_history(commit()):
        files = ", ".join(changed_code()[:5]) or "there is no git history here"
        raise ValueError(f"published results come from clean commits only; commit first: {files}")
    for stage in todo:
        if stage.stale():
            _run(stage)
        else:
            print(f"{stage.name}: what it reads came out as it was", flush=True)


def _with_sources(names: Sequence[str], known: dict[str, Stage]) -> set[str]:
    wanted: set[str] = set()
    todo = list(names)
    while todo:
        name = todo.pop()
        if name not in wanted:
            wanted.add(name)
            todo += sources(known[name], list(known.values()))
    return wanted


def _print_plan(stages: Sequence[Stage]) -> list[Stage]:
    """The stages that are stale, with those that read what these make; says why, and how long they take."""
    reasons: dict[str, str] = {}
    for stage in stages:
        changing = [name for name in sources(stage, stages) if reasons.get(name)]
        reasons[stage.name] = stage.stale() or (f"{', '.join(changing)} will change" if changing else "")
    todo = [stage for stage in stages if reasons[stage.name]]
    minutes = {stage.name: stage.record().get("seconds", 60.0 * stage.minutes) / 60.0 for stage in stages}
    rows = [(s.name, reasons[s.name] or "up to date", f"{minutes[s.name]:.0f}" if s in todo else "") for s in stages]
    print_table("Published results", ("stage", "state", "minutes"), rows, left=2)
    hours = sum(minutes[stage.name] for stage in todo) / 60.0
    print(
        f"{len(todo)} of {len(stages)} stages to make: about {hours:.1f} hours on two cores"
        if todo
        else "all is up to date"
    )
    return todo


def _run(stage: Stage) -> None:
    """Run a stage, or what is left of it, and publish."""
    state, work = stage.state(), stage.work
    clock = work / "seconds.txt"
    before = float(read_text(clock)) if clock.exists() else 0.0
    command = stage.command.format(work=work.relative_to(CHECKOUT))
    print(f"{stage.name}: probe-env {command.strip()}", flush=True)
    begin = time.perf_counter()
    try:
        status = subprocess.run(
            [sys.executable, "-m", "agents.cli", *shlex.split(command)],
            cwd=CHECKOUT,
            env=os.environ | {STAGE_VARIABLE: stage.name},
            check=False,
        )
    finally:
        seconds = before + time.perf_counter() - begin
        if work.exists():
            write_atomically(clock, f"{seconds:.0f}\n")
    if status.returncode:
        raise RuntimeError(f"stage {stage.name} failed (exit status {status.returncode}); it goes on when run again")
    files = _publish(stage, work)
    write_json(RECORDS / f"{stage.name}.json", provenance() | state | {"seconds": round(seconds), "files": files})


def _publish(stage: Stage, work: Path) -> list[str]:
    """Put a stage's files in their published places; files of an earlier run that there are no more go."""
    files: dict[str, Path] = {}
    for folder, pattern, paths in stage.to_publish(work):
        if not paths:
            raise RuntimeError(f"stage {stage.name}: {work} holds no {pattern} to publish")
        files |= {str(Path(folder) / path.relative_to(work)): path for path in paths}
    for target, path in files.items():
        write_atomically(CHECKOUT / target, path.read_bytes())
    for gone in set(stage.record().get("files", ())) - set(files):
        (CHECKOUT / gone).unlink(missing_ok=True)
    return sorted(files)
