"""Files are whole, and what killed processes left of them is removed."""

import os
import platform
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from probe_agents.records.atomic import write_atomically


def test_temporary_file_of_a_dead_process_is_removed(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    here, parent = f"{ended.pid}@{platform.node()}", f"{os.getppid()}@{platform.node()}"  # which may be writing
    kept = {f".{name}.x1_y.tmp" for name in (
        f"a.csv.{parent}", f"a.csv.{ended.pid}@another-machine", f"a.csv.gz.{here}", f"b.csv.{here}"
    )}  # fmt: skip
    for name in (*kept, f".a.csv.{here}.x1_y.tmp"):
        (tmp_path / name).write_text("half")
    write_atomically(tmp_path / "a.csv", "whole")
    assert (tmp_path / "a.csv").read_text() == "whole"
    assert {path.name for path in tmp_path.iterdir()} == kept | {"a.csv"}


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


@pytest.mark.skipif(os.name == "nt", reason="files of POSIX")
def test_irregular_files_are_not_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the path of a socket must be short
    controller, terminal = os.openpty()
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind("socket")
    Path("device").symlink_to(os.ttyname(terminal))
    Path("loop").symlink_to("loop")

    def identities():  # without the time of access: a link is read
        found = {path.name: path.lstat() for path in tmp_path.iterdir()}
        return {name: (*now[:7], now.st_mtime_ns, now.st_ctime_ns) for name, now in found.items()}

    before = identities()
    for name in ("pipe", "socket", "device", "loop"):
        with pytest.raises(ValueError, match=f"^{name} is not a regular file: give the name of a file to write$"):
            write_atomically(Path(name), "text")
    assert identities() == before
    os.close(controller)
    os.close(terminal)


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
@pytest.mark.parametrize("old", [True, False])
def test_a_link_stays_and_its_target_is_written(tmp_path, old):
    (tmp_path / "data").mkdir()
    target, link = tmp_path / "data" / "a.csv", tmp_path / "link.csv"
    if old:
        target.write_text("old")
    link.symlink_to("data/a.csv")
    write_atomically(link, "new")
    assert (os.readlink(link), target.read_text()) == ("data/a.csv", "new")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.csv", "data", "link.csv"]


@pytest.mark.skipif(os.name == "nt", reason="modes of POSIX")
def test_the_mode_is_that_of_the_old_file_or_follows_the_umask(tmp_path):
    for name, mode in (("private", 0o600), ("group", 0o664)):
        (tmp_path / name).touch()
        (tmp_path / name).chmod(mode)
    umask = os.umask(0o027)
    try:
        for name in ("private", "group", "new"):
            write_atomically(tmp_path / name, "text")
    finally:
        os.umask(umask)
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
    assert modes == {"private": 0o600, "group": 0o664, "new": 0o640}
