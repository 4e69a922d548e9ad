"""Whether changed code gives what the code that made a result gave: a sample of both, compared to the last bit.

Code that is moved keeps its hash; code that is rewritten does not, though it may compute the same. Then a stage's
``sample``, its command with fewer tubes or trials, is run with the commit that made the results and with the present
one, on this machine. Where all numbers that are published agree the results are kept under the new hash, and their
record says so. What the present code writes besides, columns of a table or rows of other figures, is told and does not
count; nor do columns that the stored table has not.

A sample of the code before is kept, so that it is run once, however often the present code is mended. No sample is run
where only the measure changed, how code is hashed or which files a stage reads, and that commit had
by today's measure the code and inputs of today.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from agents.publishing.stages import APART, RECORDS, WORK, Stage, load_stages, texts
from agents.publishing.trees import checked_out_once, put_inputs, states_by_today, states_in
from agents.records.provenance import (
    CHECKOUT,
    changed_code,
    commit,
    committed_at,
    in_history,
    write_atomically,
    write_json,
)
from agents.terminal.tables import print_table
from probe_env.files import read_text

COMPARED: Final = (".csv", ".npz", ".toml")
SAMPLES: Final = CHECKOUT / "configs" / "samples"
"""What samples are made of, the same for the code before and the present one: ``{samples}`` in them."""


def confirm_results(names: Sequence[str], since: str = "") -> None:
    """Keep the results of stages whose code or command changed without changing what they give.

    Args:
        names: of the stages; none: all.
        since: a commit at which they were up to date, whose code the samples are compared with; default: of each stage
            the newest one that made or confirmed it.

    Raises:
        ValueError: no such stage or commit, or the code differs from the commit.
        RuntimeError: a sample failed, or differs: names the stage and the file; or a stage was not up to date then.
            Those before it are kept.
    """
    stages = {stage.name: stage for stage in load_stages()}
    for name in names:
        if name not in stages:
            raise ValueError(f"stage = {name!r} is not one of {', '.join(stages)}")
    if not in_history(commit()):
        files = ", ".join(changed_code()[:5]) or "there is no git history here"
        raise ValueError(f"results are kept for clean commits only; commit first: {files}")
    if since and not in_history(since):
        raise ValueError(f"since = {since!r} is no commit before this one")
    chosen = [stages[name] for name in names or stages]
    rows = []
    with checked_out_once() as tree_of:
        for stage in chosen:
            answer = confirm(stage, tree_of, since)
            rows.append((stage.name, answer))
            print(f"{stage.name}: {answer}", flush=True)
    print_table("Confirmed results", ("stage", "outcome"), rows, left=2)


def confirm(stage: Stage, tree_of: Callable[[str], Path], since: str = "") -> str:
    """Run a stage's sample with the commit that made it and with this code; keep the results if they agree.

    Args:
        stage: whose code or command may have changed.
        tree_of: commit -> its files.
        since: the commit to compare with, at which the stage was up to date; default: the newest that made or
            confirmed it.

    Returns:
        what was found, in words; how many rows of stores stay as they are, with a hash that the sample does not know:
        they do not count as done.

    Raises:
        RuntimeError: a run failed, or the first file in which they differ; or it was not up to date then.
    """
    record, state = stage.record(), stage.state()
    changed = [name for name, value in state.items() if record.get(name) != value]
    if not record or not changed:
        return "up to date" if record else "never made"
    compared_with = since or _last(record)
    tree = tree_of(compared_with)
    if since and not _up_to_date(stage, record, tree):
        raise RuntimeError(f"stage {stage.name}: its results were not up to date at {since}: leave --since out")
    if _is_the_same(stage, record, tree):
        _keep(stage, record, {}, sample={})
        return "by today's measure the same code and inputs: kept"
    if "inputs" in changed:
        return f"{' and '.join(changed)} changed: make it again"
    if not (stage.sample or stage.script):
        return "no sample is known: make it again"
    place = WORK / f"{stage.name}-sample"
    folders = {"before": place / f"before-{compared_with}", "now": place / "now"}
    shutil.rmtree(folders["now"], ignore_errors=True)
    put_inputs(stage, tree)  # what the results were made from may have been published after the commit
    _run_once(stage, record, tree, folders["before"])
    _run(stage, stage.command, CHECKOUT, folders["now"])
    difference = first_difference(folders["before"], folders["now"], _stored(stage, folders["before"]))
    if difference:
        raise RuntimeError(f"stage {stage.name}: {difference}; the results are stale: make them again")
    for line in additions(*folders.values()):
        print(f"{stage.name}: {line}, which the stored results have not: make them again to have them", flush=True)
    others = _keep(stage, record, new_hashes(*folders.values()), stage.sample)
    return f"the same: kept, but for {others} rows of other code" if others else "the same: kept"


def _up_to_date(stage: Stage, record: dict[str, Any], tree: Path) -> bool:
    """Whether results were, by the code and configuration of a tree, what those make."""
    then = states_in(tree).get(stage.name)
    return then is not None and all(record[name] == value for name, value in then.items())


def _is_the_same(stage: Stage, record: dict[str, Any], tree: Path) -> bool:
    """Whether results were up to date in a tree which by today's measure has the code and inputs of today.

    Rows of stores have hashes of their own, which only a sample tells.
    """
    stores = [name for name in record["files"] if name.endswith(".csv") and "code" in _columns(CHECKOUT / name)]
    if stores or record["command"] != stage.command or not _up_to_date(stage, record, tree):
        return False
    return states_by_today(tree).get(stage.name) == stage.state()


def _columns(path: Path) -> list[str]:
    return list(texts(path).columns)


def _last(record: dict[str, Any]) -> str:
    """The newest commit that has made or confirmed some of the results: rows carry the hashes of its code."""
    names: set[str] = {record["commit"], *(entry["confirmed_at"] for entry in record.get("confirmed", ()))}
    for path in (CHECKOUT / name for name in record["files"] if name.endswith(".csv")):
        if {"code", "commit"} <= set(_columns(path)):
            names |= set(texts(path)["commit"])
    return max(sorted(names), key=committed_at) if len(names) > 1 else names.pop()


def sampled(command: str, sample: dict[str, str]) -> str:
    """A command with some options set to other values, wherever they stood before."""
    words = shlex.split(command)
    for option, value in sample.items():
        flag = f"--{option}"
        if flag in words:
            words[words.index(flag) + 1] = value
        else:
            words += [flag, value]
    return shlex.join(words)


def _run_once(stage: Stage, record: dict[str, Any], tree: Path, folder: Path) -> None:
    """Run a sample with the code before; one that has run to its end here, with these inputs, is not run again."""
    mark = folder / "sample.json"
    asked = {"command": sampled(record["command"], stage.sample), "inputs": record["inputs"]}
    if mark.exists() and json.loads(read_text(mark)) == asked:
        print(f"{stage.name}: its sample with the code in {tree} is there", flush=True)
        return
    shutil.rmtree(folder, ignore_errors=True)
    _run(stage, record["command"], tree, folder)
    write_json(mark, asked)


def _run(stage: Stage, command: str, tree: Path, folder: Path) -> None:
    print(f"{stage.name}: sample with the code in {tree}", flush=True)
    words = ["-m", "agents.cli", *shlex.split(sampled(command, stage.sample))]
    if stage.script:
        words = [str(CHECKOUT / stage.script), "{work}"]
    words = [word.replace("{work}", str(folder)).replace("{samples}", str(SAMPLES)) for word in words]
    done = subprocess.run([sys.executable, *words], cwd=tree, env=os.environ | {"PYTHONPATH": str(tree)}, check=False)
    if done.returncode:
        raise RuntimeError(
            f"stage {stage.name}: the sample failed (exit status {done.returncode}) with the code in {tree}"
        )


def _stored(stage: Stage, folder: Path) -> dict[str, Path]:
    """File of a sample's folder -> what is published in its place, if anything is."""
    targets = {
        str(path.relative_to(folder)): CHECKOUT / place / path.relative_to(folder)
        for place, _, paths in stage.to_publish(folder)
        for path in paths
    }
    return {name: path for name, path in targets.items() if path.exists()}


def first_difference(before: Path, now: Path, stored: Mapping[str, Path]) -> str:
    """What differs between the results in two folders; empty if nothing does.

    Args:
        before: folder of a sample with the code before.
        now: folder of the same with the present one.
        stored: file in them -> the published one. Others are not compared, nor columns that a published table has not.
    """
    names = [
        sorted(name for name in stored if Path(name).suffix in COMPARED and (folder / name).exists())
        for folder in (before, now)
    ]
    if not names[0]:
        return f"{before} holds nothing to compare"
    if names[0] != names[1]:
        return f"the files differ: {', '.join(sorted(set(names[0]) ^ set(names[1])))}"
    return next((f"{name} differs" for name in names[0] if not _equal(before / name, now / name, stored[name])), "")


def _equal(one: Path, other: Path, stored: Path) -> bool:
    if one.suffix == ".csv":
        left, right = (_rows(path).drop(columns=list(APART), errors="ignore") for path in (one, other))
        known = _columns(stored)
        return _holds(right, left[[name for name in left.columns if name in known]])
    if one.suffix == ".npz":
        with np.load(one) as left, np.load(other) as right:
            return left.files == right.files and all(np.array_equal(left[name], right[name]) for name in left.files)
    return one.read_bytes() == other.read_bytes()


def _holds(table: pd.DataFrame, part: pd.DataFrame) -> bool:
    """Whether a table has all columns of another and all its rows, in their order; between them there may be others."""
    if not set(part.columns) <= set(table.columns) or part.empty != table.empty:
        return False
    rows = iter(table[list(part.columns)].fillna("").itertuples(index=False, name=None))
    return all(row in rows for row in part.fillna("").itertuples(index=False, name=None))


def additions(before: Path, now: Path) -> list[str]:
    """What the tables of ``now`` have besides, a line a table."""
    lines = []
    for path in sorted(before.rglob("*.csv")):
        old, new = _rows(path), _rows(now / path.relative_to(before))
        columns, rows = [name for name in new.columns if name not in old.columns], len(new) - len(old)
        if columns or rows:
            parts = [f"{len(columns)} new columns ({columns[0]}, ...)"] if columns else []
            parts += [f"{rows} new rows"] if rows else []
            lines.append(f"{path.relative_to(before)}: {', '.join(parts)}")
    return lines


def _rows(path: Path) -> pd.DataFrame:
    """A table as text; the rows of a store stand in the order in which they ended, so they are sorted."""
    table = texts(path)
    if "code" in table:
        table = table.sort_values([name for name in table.columns if name not in APART], ignore_index=True)
    return table


def new_hashes(before: Path, now: Path) -> dict[str, str]:
    """Hash of the old code -> of the new, for the rows of the stores in two folders that agree."""
    names: dict[str, str] = {}
    for path in sorted(before.rglob("*.csv")):
        old, new = _rows(path), _rows(now / path.relative_to(before))
        if "code" in old:
            names |= dict(zip(old["code"], new["code"], strict=True))
    return names


def _keep(stage: Stage, record: dict[str, Any], hashes: dict[str, str], sample: dict[str, str]) -> int:
    """Write the new code's hash into the record, and into rows that carry theirs; the numbers stay as they were made.

    The record has the sample that was run, an empty one if there was none.

    A row of a store counts as done while its hash is that of the present code.
    """
    others = 0
    for path in (CHECKOUT / name for name in record["files"] if hashes and name.endswith(".csv")):
        table = _rows(path)
        if "code" in table:
            counting = table.get("superseded", pd.Series("False", table.index)) != "True"
            others += int((counting & ~table["code"].isin([*hashes, *hashes.values()])).sum())
        text = path.read_text()
        renewed = re.sub(r"\b[0-9a-f]{16}\b", lambda match: hashes.get(match[0], match[0]), text)
        if renewed != text:
            write_atomically(path, renewed)
    state = stage.state()
    shown = {"from": record["code"], "made_by": record["commit"], "confirmed_at": commit(), "sample": sample}
    write_json(RECORDS / f"{stage.name}.json", record | state | {"confirmed": [*record.get("confirmed", ()), shown]})
    return others
