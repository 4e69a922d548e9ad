"""Compiled kernels: stored in a private folder if no other can be written, and deleted if their sources change."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import probe_env
from probe_env import kernel_cache

USE = """
from probe_env.physics.model.drive import Drive, _inputs
Drive(0.2, 10.0).inputs_of_steps(3, 1e-4, 0.025, 0)
import numba, probe_env
print(probe_env.__file__)
print(numba.config.CACHE_DIR)
print(sum(_inputs.stats.cache_hits.values()))
"""


@pytest.fixture
def installation(tmp_path):
    """A copy of the package without a writable cache, even for root: __pycache__ is a file."""
    package = tmp_path / "site" / "probe_env"
    shutil.copytree(Path(probe_env.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in (package, *(path for path in package.rglob("*") if path.is_dir())):
        (folder / "__pycache__").touch()
    (tmp_path / "temporary").mkdir()
    return tmp_path


def run(code, folder, home, **environment):
    """Outcome of a new interpreter that imports the copy in a folder."""
    ours = ("NUMBA", "XDG", "PYTHON", "COV")
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    paths = {"HOME": str(home), "LOCALAPPDATA": str(home), "PYTHONPATH": str(folder / "site")}
    environment = inherited | paths | environment
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stderr
    return done


def use(installation, **environment):
    """Of its smallest kernel; /dev/null has no folders."""
    environment |= {"TMPDIR": str(installation / "temporary"), "PYTHONWARNINGS": "default"}
    done = run(USE, installation, "/dev/null/home", **environment)
    file, folder, hits = done.stdout.split("\n")[:3]
    assert Path(file).parent == installation / "site" / "probe_env"
    return folder, int(hits), done.stderr


@pytest.mark.slow
def test_a_temporary_folder_is_used_and_named_once(installation):
    folder, hits, warning = use(installation)
    assert Path(folder).parent == installation / "temporary"
    assert Path(folder).stat().st_mode & 0o077 == 0
    assert list(Path(folder).rglob("*.nbc"))
    assert warning.count("set NUMBA_CACHE_DIR to choose another") == 1
    assert folder in warning
    assert hits == 0
    again, hits, warning = use(installation, NUMBA_CACHE_DIR="/dev/null/chosen")
    assert (again, hits) == (folder, 1)  # the next interpreter uses the compiled kernels
    assert "neither NUMBA_CACHE_DIR = /dev/null/chosen nor the package's folder" in warning


KERNEL = """
from numba import njit
from probe_env.physics.model.other import value
@njit(cache=True)
def kernel():
    return value()
"""
OTHER = """
from numba import njit
@njit
def value():
    return {value}
"""
CALL = """
from probe_env.physics.kernel import kernel
print(kernel(), sum(kernel.stats.cache_hits.values()))
"""


@pytest.mark.slow
@pytest.mark.parametrize("next_to_sources", [True, False], ids=["next to the sources", "in a home"])
def test_kernels_are_deleted_when_compiled_sources_change(tmp_path, next_to_sources):
    """numba checks the file of a kernel only, not functions of other files that are compiled into it."""
    package = tmp_path / "site" / "probe_env"
    shutil.copytree(Path(probe_env.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "physics" / "kernel.py").write_text(KERNEL)
    if not next_to_sources:
        for folder in (package, package / "physics"):
            (folder / "__pycache__").touch()
    outcomes = []
    for value in (1, 1, 2):
        (package / "physics" / "model" / "other.py").write_text(OTHER.format(value=value))
        outcomes.append(run(CALL, tmp_path, tmp_path).stdout.split())
    assert outcomes == [["1", "0"], ["1", "1"], ["2", "0"]]
    assert bool(list(package.rglob("*.nbc"))) == next_to_sources


@pytest.mark.parametrize("kind", ["open", "link", "file"])
def test_a_folder_that_others_may_write_is_not_trusted(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    planted = kernel_cache._folder()
    assert kernel_cache._folder() == planted  # the user's folder is used again
    planted.rmdir()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    if kind == "open":
        planted.mkdir()
        planted.chmod(0o777)
    elif kind == "link":
        planted.symlink_to(elsewhere)
    else:
        planted.touch()
    chosen = kernel_cache._folder()
    assert chosen != planted
    assert chosen.is_dir()
    assert chosen.stat().st_mode & 0o077 == 0


def test_no_folder_is_an_error(monkeypatch):
    monkeypatch.setattr(kernel_cache, "_numbas_folder", lambda: None)
    monkeypatch.setattr(tempfile, "tempdir", "/dev/null/temporary")
    with pytest.raises(RuntimeError, match="set NUMBA_CACHE_DIR to one that can"):
        kernel_cache.ensure_kernel_cache()
