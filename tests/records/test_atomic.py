"""Files are whole, and what killed processes left of them is removed."""

import os
import platform
import subprocess
import sys

import pytest

from agents.records.atomic import write_atomically


@pytest.fixture(scope="module")
def dead():
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def left(folder, name, process, machine=None):
    path = folder / f".{name}.{process}@{machine or platform.node()}.x1_y.tmp"
    path.write_text("half")
    return path


def test_what_a_dead_process_left_of_the_same_file_is_removed(tmp_path, dead):
    gone = left(tmp_path, "a.csv", dead)
    kept = [
        left(tmp_path, "a.csv", os.getppid()),  # it may be writing
        left(tmp_path, "a.csv", dead, "another-machine"),
        left(tmp_path, "a.csv.gz", dead),
        left(tmp_path, "b.csv", dead),
    ]
    write_atomically(tmp_path / "a.csv", "whole")
    assert (tmp_path / "a.csv").read_text() == "whole"
    assert not gone.exists()
    assert all(path.exists() for path in kept)


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    write_atomically(tmp_path / "a.csv", "old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(tmp_path / "a.csv", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    assert (tmp_path / "a.csv").read_text() == "old"


def test_no_pattern_of_results_takes_a_temporary_file_for_one(tmp_path, dead):
    for suffix in ("csv", "json", "jsonl", "parquet", "toml", "npz", "pt"):
        left(tmp_path, f"a.{suffix}", dead)
        assert not list(tmp_path.glob(f"*.{suffix}"))


def test_a_folder_is_no_file(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(ValueError, match="out is a folder: give the name of a file to write"):
        write_atomically(tmp_path / "out", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
