"""Files are whole, and what killed processes left of them is removed."""

import os
import platform
import subprocess
import sys

import pytest

from agents.records.atomic import write_atomically


def test_what_a_dead_process_left_of_the_same_file_is_removed(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    here, left = platform.node(), []
    for name, process, machine in (
        ("a.csv", ended.pid, here),
        ("a.csv", os.getppid(), here),  # it may be writing
        ("a.csv", ended.pid, "another-machine"),
        ("a.csv.gz", ended.pid, here),
        ("b.csv", ended.pid, here),
    ):
        left.append(tmp_path / f".{name}.{process}@{machine}.x1_y.tmp")
        left[-1].write_text("half")
    write_atomically(tmp_path / "a.csv", "whole")
    assert (tmp_path / "a.csv").read_text() == "whole"
    assert [path.exists() for path in left] == [False, True, True, True, True]
    assert [path.name for path in tmp_path.glob("*.csv")] == ["a.csv"]


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    write_atomically(tmp_path / "a.csv", "old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(tmp_path / "a.csv", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    assert (tmp_path / "a.csv").read_text() == "old"


def test_a_folder_is_no_file(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(ValueError, match="out is a folder: give the name of a file to write"):
        write_atomically(tmp_path / "out", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
