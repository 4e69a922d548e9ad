"""Extras: a plain install has what the simulator imports, and a missing module is named with its extra."""

import ast
import sys
import tomllib
from pathlib import Path

import pytest

from probe_agents.cli import main
from probe_agents.cli.registry import COMMANDS, EXTRAS, NEEDS, extra_with, modules_of

ROOT = Path(__file__).parents[2]
PARTS = {"pydantic_core": "pydantic", "llvmlite": "numba"}
"""Modules that always come with another package."""


@pytest.fixture(autouse=True)
def metadata(monkeypatch):
    """The requirements of ``pyproject.toml``, whatever is installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    lines = [f"{line}; extra == '{extra}'" for extra, listed in optional.items() for line in listed]
    monkeypatch.setattr("probe_agents.cli.registry.requires", lambda _: project["dependencies"] + lines)


def imported(package):
    names = set()
    for path in (ROOT / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names.add(node.module.partition(".")[0])
    return {PARTS.get(name, name) for name in names} - sys.stdlib_module_names - {"probe_env", "probe_agents"}


def test_extras_name_what_is_imported():
    assert modules_of() == imported("probe_env")
    assert set(NEEDS) <= set(COMMANDS)
    assert set(NEEDS.values()) <= set(EXTRAS)
    assert imported("agents") - imported("probe_env") - {"ray"} <= set().union(*map(modules_of, EXTRAS))


def test_missing_module_names_the_smallest_extra(monkeypatch, capsys):
    assert [extra_with(name) for name in ("PIL", "emcee", "tornado", "x")] == ["commands", "plant", "app", None]
    for command, module, extra in (
        ("simulate", "tyro", "commands"), ("simulate", "tyro.conf", "commands"), ("evaluate", "sb3_contrib", "agents"),
        ("train", "tyro", "agents"), ("log", "tyro", "plant"), ("app", "tyro", "app"), ("app", "torch", "agents"),
    ):  # fmt: skip

        def missing(*_, name=module):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

        monkeypatch.setattr("probe_agents.cli.parsing.parse", missing)
        assert main([command]) == 2
        package = module.partition(".")[0]
        line = f'{command} needs {package}, which is not installed: pip install "probe-env[{extra}]"'
        assert capsys.readouterr() == ("", f"probe-env: error: {line}\n")
