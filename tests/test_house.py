"""The plan of the house: folders of at most a dozen files that say what they are for, functions that can be read."""

import ast
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(path for package in ("probe_env", "agents") for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
OTHERS = sorted(path for folder in ("configs", "docs") for path in (ROOT / folder).rglob("*.py"))
ROOMS = sorted({path.parent for path in FILES})
FOLDERS = sorted({path.parent for path in (*FILES, *TESTS)})
PARTS = {"what enters": r"\benters?\b", "what leaves": r"\bleaves?\b", "what it may import": r"\bImports\b"}
"""What the ``__init__`` of a room says: "... enter(s)", "... leave(s)", and "Imports ..."."""
MOST_FILES, MOST_LINES, MOST_PARAMETERS = 12, 60, 7
MOST_BYTES = 5_000_000
VAGUE = {"told", "made", "was", "again", "found"}
"""Names that do not say what they stand for; modules may have them."""


def functions():
    """File and name of every function that is no kernel, its lines, and its parameters.

    Lines of docstrings are no code and do not count: a function is not the shorter for saying less.
    """
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.FunctionDef) or any("njit" in ast.unparse(d) for d in node.decorator_list):
                continue
            first = node.body[0]
            documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
            described = first.end_lineno - first.lineno + 1 if documented else 0
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            lines = node.end_lineno - node.lineno + 1 - described
            yield f"{path.relative_to(ROOT)} {node.name}", lines, len([n for n in names if n not in ("self", "cls")])


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_room_has_at_most_a_dozen_files(folder):
    modules = [path for path in (*FILES, *TESTS) if path.parent == folder and path.name != "__init__.py"]
    assert len(modules) <= MOST_FILES


@pytest.mark.parametrize("folder", ROOMS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_room_says_what_enters_what_leaves_and_what_it_may_import(folder):
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text()))
    assert [part for part, words in PARTS.items() if not re.search(words, text)] == []


def test_functions_can_be_read():
    assert [name for name, lines, _ in functions() if lines > MOST_LINES] == []
    assert [name for name, _, parameters in functions() if parameters > MOST_PARAMETERS] == []


def test_a_kernel_needs_no_entry_in_the_settings_of_types():
    """Files of methods are checked as kernels unless they are named as strict, so a new one is not named anywhere."""
    overrides = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    named = {module for override in overrides for module in override["module"]}
    assert "probe_env.physics.methods.*" in named
    kernels = [path for path in (ROOT / "probe_env/physics/methods").rglob("*.py") if "@njit" in path.read_text()]
    assert len(kernels) > 10
    assert named.isdisjoint(".".join(path.relative_to(ROOT).with_suffix("").parts) for path in kernels)


def defined(tree):
    """Names of variables, arguments, attributes, functions and classes where they are given a value."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.ExceptHandler):
            yield node.name


def test_no_name_is_vague():
    """No variable, argument, attribute, function or class is named so: each says what it stands for."""
    names = (
        (path.relative_to(ROOT), name)
        for path in (*FILES, *TESTS, *OTHERS)
        for name in defined(ast.parse(path.read_text()))
    )
    assert [f"{path}: {name}" for path, name in names if name in VAGUE] == []


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout: what belongs to the project is not known")
def test_the_project_stays_small():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    sizes = {name: (ROOT / name).stat().st_size for name in listed.split("\0") if (ROOT / name).is_file()}
    assert len(sizes) > 500
    assert [name for name, size in sizes.items() if size > MOST_BYTES or name.endswith((".whl", ".gz"))] == []
