"""What is published: every file has a maker, and every commit that is named can be gone back to."""

import json
import re
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pandas as pd
import pytest

from agents.publishing.stages import load_stages

ROOT = Path(__file__).parents[2]
APART = (
    "results/agents/*",  # trained agents: `make train`
    "results/records/*.json", "results/chart/peers*",  # `make peers`
    "results/*/growth.png", "results/study/back.png",  # drawn by `probe-env readme`
    "results/render/*.png",  # shown in the docs
    "results/app/*",  # `make time-app`
)  # fmt: skip
"""Files of results that are of no stage."""
UNCLEAN = ("results/agents/", "docs/results/agents.md")
"""May name commits with changes: records of trained agents, until they are trained again."""
COMMIT = re.compile(r"(?:\bcommits? |\"commit\": \"|, )([0-9a-f]{12}(?:\+changes)?)\b")
PLACES = ("results", "agents", "probe_env/data", "configs/tubes", "docs", "README.md")


def git(*arguments: str) -> list[str]:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a checkout")
    return done.stdout.splitlines()


def named_commits(path: Path) -> set[str]:
    """The commits that a stored file or page says it is of."""
    if path.suffix == ".csv":
        columns = pd.read_csv(path, nrows=0).columns
        return set(pd.read_csv(path, usecols=["commit"], dtype=str)["commit"]) if "commit" in columns else set()
    return set(COMMIT.findall(path.read_text())) if path.suffix in (".json", ".md") else set()


def stored() -> Iterator[Path]:
    for name in git("ls-files", "--", *PLACES):
        path = ROOT / name
        if path.suffix in (".csv", ".json", ".md") and path.is_file():
            yield path


def test_every_stored_table_can_be_read():
    """Two trainings in one folder had left bytes of nothing in their logs."""
    for path in stored():
        if path.suffix == ".csv" and "samples" not in path.parts:
            assert b"\0" not in path.read_bytes(), path
            table = pd.read_csv(path, comment="#")
            assert len(table) > 0, path
            assert not any(str(name).startswith("Unnamed") for name in table.columns), path


def test_every_result_is_of_a_stage_or_is_known_to_be_apart():
    published = [
        f"{folder}/{pattern}" for stage in load_stages() for folder, ps in stage.publish.items() for pattern in ps
    ]
    known = (*published, *APART)
    assert not [name for name in git("ls-files", "--", "results") if not any(fnmatch(name, p) for p in known)]


def test_every_named_commit_is_clean_and_in_the_history():
    if git("rev-parse", "--is-shallow-repository") == ["true"]:
        pytest.skip("a shallow clone has no history")
    history = {commit[:12] for commit in git("rev-list", "HEAD")}
    places = defaultdict(set)
    for path in stored():
        for name in named_commits(path):
            places[name].add(str(path.relative_to(ROOT)))
    assert len(places) > 10
    for name, files in places.items():
        assert name.removesuffix("+changes") in history, (name, files)
        assert name in history or all(file.startswith(UNCLEAN) for file in files), (name, files)


def test_a_record_names_what_it_is_of():
    for stage in load_stages():
        record = json.loads((ROOT / "results" / "records" / f"{stage.name}.json").read_text())
        assert record["files"], stage.name
        assert all((ROOT / name).is_file() for name in record["files"]), stage.name
