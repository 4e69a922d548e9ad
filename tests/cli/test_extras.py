"""What a plain install has: the simulator and the environments; what is more comes with an extra that is named."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from agents.cli.extras import EXTRAS, extra_with, modules_in, modules_of, packages_of
from agents.terminal import extras

ROOT = Path(__file__).parents[2]
PARTS = {"pydantic_core": "pydantic", "llvmlite": "numba"}
"""Modules that come with the package that is named, always, and are imported beside it."""


def imported(package):
    """Modules of others that the files of a package import, wherever they do."""
    names = set()
    for path in (ROOT / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names.add(node.module.partition(".")[0])
    return {PARTS.get(name, name) for name in names} - sys.stdlib_module_names - {"probe_env", "agents"}


def test_a_plain_install_has_what_the_simulator_and_the_environments_import_and_no_more():
    assert set(modules_in(packages_of())) == imported("probe_env")


def test_an_extra_names_what_agents_import_besides():
    apart = {"ray"}  # says so itself
    assert imported("agents") - imported("probe_env") - apart <= {m for name in EXTRAS for m in modules_of(name)}


def test_the_installed_package_and_the_checkout_say_the_same(monkeypatch):
    installed = {name: modules_of(name) for name in EXTRAS}
    packages_of.cache_clear()

    def missing(_):
        raise PackageNotFoundError

    monkeypatch.setattr(extras, "requires", missing)
    assert {name: modules_of(name) for name in EXTRAS} == installed
    packages_of.cache_clear()


@pytest.mark.parametrize(
    ("module", "extra"),
    [
        ("tyro", "commands"),
        ("PIL", "commands"),
        ("emcee", "agents"),
        ("corner", "agents"),
        ("tornado", "app"),
        ("x", None),
    ],
)
def test_a_module_leads_to_the_smallest_extra(module, extra):
    assert extra_with(module) == extra


def test_extras_of_users_hold_the_commands():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for name in ("agents", "app", "dev"):
        assert "probe-env[commands]" in project["optional-dependencies"][name]


def test_without_the_commands_one_line_names_their_extra(tmp_path):
    """``probe-env`` itself imports nothing of the extra before it says so."""
    code = f"""
import sys
class Hidden:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in {modules_of("commands")}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
from agents.cli import main
sys.exit(main(sys.argv[1:]))
"""

    def run(*arguments):
        done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=tmp_path)
        return done.returncode, done.stdout, done.stderr

    line = 'probe-env: error: this command needs tyro, which is not installed: pip install "probe-env[commands]"\n'
    for name in ("simulate", "evaluate"):
        assert run(name) == (2, "", line)
    assert run("--help")[0] == 0
    assert run("--version")[0] == 0
