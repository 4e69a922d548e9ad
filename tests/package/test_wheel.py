"""The wheel as a user gets it: built, installed outside the checkout, used by name in an empty folder.

Its dependencies are those of the running environment, which a ``.pth`` file shows to it; what a user may not have
installed is hidden by an import hook.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pandas as pd
import pytest

from probe_agents.cli.registry import EXTRAS, modules_of
from probe_agents.records.shipped import shipped_agents, shipped_names
from probe_env.kernel_cache import STAMP

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
COMMANDS = modules_of("commands")
BEYOND = set().union(*map(modules_of, EXTRAS)) - COMMANDS
"""Modules that the extras plant, agents and app bring."""
NO_BACKEND = ("No matching distribution found for hatchling", "Failed to establish a new connection", "ConnectionError")
TRAINING = """
seeds = [0]
phases = 1
phase_steps = 64
[environment]
num_envs = 4
fidelity = { time_lapse = 20.0 }
task = { settle_time = 0.1, time_limit = 20.0 }
[network]
net_arch = [8]
[validation]
limit = 1
fidelity = { time_lapse = 20.0 }
[learning]
n_steps = 16
batch_size = 32
"""
SHORT = ["--limit", "1", "--fidelity", "fast"]
HIDDEN = """
import sys
class Hidden:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in HIDDEN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hidden())
"""


def hiding(folder, modules):
    """The folder for PYTHONPATH with which these modules are not installed."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(f"HIDDEN = {set(modules)}\n{HIDDEN}")
    return str(folder)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    here = ["--no-build-isolation"] if find_spec("hatchling") else []  # else pip gets it, from an index
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", *here, "--wheel-dir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode and any(reason in done.stdout + done.stderr for reason in NO_BACKEND):
        pytest.skip("hatchling is not installed and cannot be had: no wheel can be built")
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory):
    """The interpreter of an environment with nothing of ours but the wheel, and kernels that need no compiling."""
    folder = tmp_path_factory.mktemp("installed")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.strip())
    (site / "dependencies.pth").write_text(  # a .pth file there, as of an editable install, is not followed
        "\n".join({sysconfig.get_path("purelib"), sysconfig.get_path("platlib")})
    )
    command = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", str(wheel)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for path in (*(ROOT / "probe_env").rglob("*.nb[ic]"), *(ROOT / "probe_env").rglob(STAMP)):
        target = site / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    return python


@pytest.fixture
def run(python, tmp_path, monkeypatch):
    """Runs the installed command, or Python, in an empty folder; asserts the status, returns both streams."""
    monkeypatch.delenv("PYTHONPATH", raising=False)  # a checkout on it would be found first
    monkeypatch.setenv("COLUMNS", "80")
    (tmp_path / "empty").mkdir()
    program = {"probe-env": python.with_name("probe-env"), "python": python}

    def result(name, *arguments, status=0, **environment):
        done = subprocess.run(
            [str(program[name]), *arguments], capture_output=True, text=True, cwd=tmp_path / "empty",
            env=os.environ | environment,
        )  # fmt: skip
        assert done.returncode == status, done.stdout + done.stderr
        return done.stdout, done.stderr

    result.folder = tmp_path / "empty"
    return result


def test_the_wheel_holds_what_users_name(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        metadata = archive.read(next(name for name in names if name.endswith("METADATA"))).decode()
    shipped = "probe_agents/shipped"
    agents = shipped_agents().items()
    bundles = {f"{shipped}/agents/{name}/seed-{k}/agent.safetensors" for name, seeds in agents for k in seeds}
    kinds = ("scenes", "design", "train", "studies")
    files = {f"{shipped}/{kind}/{name}.toml" for kind in kinds for name in shipped_names(kind)}
    data = {
        "probe_env/data/contexts.csv", "probe_env/data/vibration-map.npz",
        "probe_env/py.typed", "probe_agents/py.typed",
        *(f"{shipped}/{name}" for name in ("schedules/example.csv", "logs/example-rig.csv", "tubes/example.toml")),
    }  # fmt: skip
    assert (bundles | files | data) - names == set()
    assert not [n for n in names if n.endswith("-trials.csv")]
    top = {name.partition("/")[0] for name in names if ".dist-info/" not in name}
    assert top == {"probe_env", "probe_agents"}  # openai-agents and many a user's folder are called agents
    assert any(name.endswith("licenses/LICENSE") for name in names)
    for line in (f"Version: {version('probe-env')}", "License-Expression: MIT", *(f"Extra: {e}" for e in EXTRAS)):
        assert line in metadata


def test_installed_commands_beside_a_folder_agents(run, python, tmp_path, monkeypatch):
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").write_text("raise ImportError('a package of the user')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    site, code = python.parents[1], "import probe_env, probe_agents; print(probe_env.__file__, probe_agents.__file__)"
    assert all(Path(file).is_relative_to(site) for file in run("python", "-c", code)[0].split())
    assert run("probe-env", "--version")[0] == f"probe-env {version('probe-env')}\n"
    assert "student" in run("probe-env", "agents")[0]
    assert "robustness" in run("probe-env", "study", "--list")[0]
    before = installed_files(site)

    policies = ["ppo", "pi"] if find_spec("torch") else ["pi"]
    evaluated = ["evaluate", *policies, *SHORT, "--output", "out"]
    assert "pi: 1 of 1 complete" in run("probe-env", *evaluated)[0]
    assert pd.read_csv(run.folder / "out" / "episodes.csv")["policy"].tolist() == policies
    assert (run.folder / "out" / "report.html").stat().st_size > 100_000
    assert json.loads((run.folder / "out" / "manifest.json").read_text())["commit"] == "unknown"

    briefly = ["--duration", "0.3", "--statistics-from", "0.1"]
    run("probe-env", "simulate", "fig11_l10", "--method", "superelement32", *briefly)
    assert (run.folder / "output" / "fig11_l10" / "signals.npz").exists()
    run("probe-env", "render", "--view", "strip", "--at", "10", "--duration", "0.1", "--output", "out/strip.png")
    assert (run.folder / "out" / "strip.png").stat().st_size > 10_000
    if find_spec("torch"):
        (run.folder / "out" / "mine.toml").write_text(TRAINING)
        run("probe-env", "train", "out/mine.toml", "--output", "out/train")
        mine = "mine=out/train/seed-0/agent.safetensors"
        assert "mine" in run("probe-env", "evaluate", mine, *SHORT, "--output", "out/mine")[0]
    assert {path.name for path in run.folder.iterdir()} == {"out", "output"}
    assert installed_files(site) == before  # nothing was written there


def test_without_an_extra_one_line_names_it(run, tmp_path):
    hidden = hiding(tmp_path / "hidden", BEYOND)
    for arguments, extra in (
        (["train", "ppo"], "agents"),
        (["design"], "agents"),
        (["study", "best-schedules"], "agents"),
        (["study", "vibration-map"], "agents"),
        (["evaluate", "pi", "ppo"], "agents"),
        (["log", "example-rig"], "plant"),
        (["calibrate", "example-rig"], "plant"),
        (["app", "--port", "0", "--no-show"], "app"),
    ):
        printed, error = run("probe-env", *arguments, status=2, PYTHONPATH=hidden)
        module = re.search(r" needs (\w+)", error)
        assert module, (arguments, error)
        assert module[1] in BEYOND, arguments
        line = f'{arguments[0]} needs {module[1]}, which is not installed: pip install "probe-env[{extra}]"'
        assert (printed, error) == ("", f"probe-env: error: {line}\n")
    assert list(run.folder.iterdir()) == []


def test_a_plain_install_is_the_simulator_and_the_environments(run, tmp_path):
    """An environment loads nothing that commands alone need, and every command names their extra."""
    hidden = hiding(tmp_path / "hidden", COMMANDS | BEYOND)
    code = "import gymnasium, probe_env, sys; gymnasium.make('probe_env/Insertion-v1').reset(seed=0)"
    assert run("python", "-c", f"{code}; print('reset')", PYTHONPATH=hidden)[0] == "reset\n"
    loaded = set(run("python", "-c", f"{code}; print(*sys.modules)")[0].split())
    others = {"charset_normalizer"}  # NumPy loads it where it is installed
    assert not loaded & {"probe_agents", "matplotlib", "pandas", *COMMANDS, *BEYOND} - others
    for arguments, extra in (
        (["simulate", "fig11_l10"], "commands"),
        (["agents"], "commands"),
        (["train", "ppo"], "agents"),
    ):
        line = f'{arguments[0]} needs tyro, which is not installed: pip install "probe-env[{extra}]"'
        assert run("probe-env", *arguments, status=2, PYTHONPATH=hidden) == ("", f"probe-env: error: {line}\n")
    assert "usage: probe-env" in run("probe-env", "--help", PYTHONPATH=hidden)[0]


def installed_files(site):
    """Files of an environment with their times, but compiled ones."""
    files = (path for path in site.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path: path.stat().st_mtime_ns for path in files}
