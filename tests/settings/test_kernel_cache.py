"""Compiled kernels: kept in one's own folder where nothing else can be written, and forgotten with their sources."""

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
    """A copy of the package beside which nothing can be kept, also not by root: __pycache__ is a file."""
    package = tmp_path / "site" / "probe_env"
    shutil.copytree(Path(probe_env.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in (package, *(path for path in package.rglob("*") if path.is_dir())):
        (folder / "__pycache__").touch()
    (tmp_path / "temporary").mkdir()
    return tmp_path


def use(installation, home="/dev/null/home", **environment):
    """Outcome of a new interpreter that imports the copy and compiles its smallest kernel; /dev/null has no folders."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA", "XDG", "PYTHON", "COV"))}
    environment = kept | {
        "HOME": home, "LOCALAPPDATA": home, "TMPDIR": str(installation / "temporary"),
        "PYTHONPATH": str(installation / "site"), "PYTHONWARNINGS": "default",
    } | environment  # fmt: skip
    done = subprocess.run([sys.executable, "-c", USE], env=environment, capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stderr
    file, folder, hits = done.stdout.split("\n")[:3]
    assert Path(file).parent == installation / "site" / "probe_env"
    return folder, int(hits), done.stderr


@pytest.mark.slow
def test_a_temporary_folder_serves_and_is_named_once(installation):
    folder, hits, warning = use(installation)
    assert Path(folder).parent == installation / "temporary"
    assert Path(folder).stat().st_mode & 0o077 == 0
    assert list(Path(folder).rglob("*.nbc"))
    assert warning.count("set NUMBA_CACHE_DIR to choose another") == 1
    assert folder in warning
    assert hits == 0
    assert use(installation)[:2] == (folder, 1)  # what was compiled serves the next interpreter


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_is_named(installation):
    folder, warning = use(installation, NUMBA_CACHE_DIR="/dev/null/chosen")[::2]
    assert Path(folder).parent == installation / "temporary"
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
@pytest.mark.parametrize("beside", [True, False], ids=["beside the sources", "in a home"])
def test_kernels_are_forgotten_when_what_is_compiled_into_them_changes(tmp_path, beside):
    """numba looks at a kernel's own file alone: it would go on with what other files had in them."""
    package = tmp_path / "site" / "probe_env"
    shutil.copytree(Path(probe_env.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "physics" / "kernel.py").write_text(KERNEL)
    if not beside:
        for folder in (package, package / "physics"):
            (folder / "__pycache__").touch()
    environment = {name: text for name, text in os.environ.items() if not name.startswith(("NUMBA", "XDG", "COV"))}
    environment |= {"HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path), "PYTHONPATH": str(tmp_path / "site")}
    outcomes = []
    for value in (1, 1, 2):
        (package / "physics" / "model" / "other.py").write_text(OTHER.format(value=value))
        done = subprocess.run([sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, cwd="/")
        outcomes.append(done.stdout.split() or done.stderr)
    assert outcomes == [["1", "0"], ["1", "1"], ["2", "0"]]
    assert bool(list(package.rglob("*.nbc"))) == beside


@pytest.mark.parametrize("kind", ["open", "link", "file"])
def test_a_folder_that_others_may_write_is_not_trusted(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    planted = kernel_cache._folder()
    assert kernel_cache._folder() == planted  # one's own is taken again
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


def test_no_folder_at_all_is_an_error_that_says_what_to_do(monkeypatch):
    monkeypatch.setattr(kernel_cache, "_numbas_folder", lambda: None)
    monkeypatch.setattr(tempfile, "tempdir", "/dev/null/temporary")
    with pytest.raises(RuntimeError, match="set NUMBA_CACHE_DIR to one that can"):
        kernel_cache.ensure_kernel_cache()
