"""A hash of the code that a result depends on: definitions found by following names from where the work starts.

It is blind to where a definition stands, to comments, docstrings, annotations, imports, checks, the wording of errors
and warnings, to what reads and writes files, and to Python's version, so files can be moved and typed without making
stored results old. What counts is the body of every function, class and constant that can be reached: a class
(annotations name classes too) with its fields and those of its methods whose names occur in what is reached. Results
of one method do not depend on the others.
"""

from __future__ import annotations

import ast
import hashlib
import itertools
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final, NamedTuple

PACKAGES: Final = ("probe_env", "agents")
REGISTRY: Final = "probe_env.physics.methods"
"""Lists all methods: a result depends on its own, which is added to the roots."""
ALL: Final = "all"
ASIDE: Final = (
    "agents.learning.checkpoints", "agents.records.arrays", "agents.records.atomic",
    "agents.records.code_hash", "agents.records.models", "agents.records.provenance",
    "agents.records.reading", "agents.records.store", "agents.records.tables", "agents.searches.database",
    "agents.terminal.work", "agents.terminal.tables", "probe_env.errors", "probe_env.files",
)  # fmt: skip
"""Modules that read, write and tell: no result depends on them. With the modules in them."""
SHOWN_BY: Final = ("__repr__", "__str__", "_repr_html_")
"""Methods that show an object: no result depends on them."""
IGNORED_FIELDS: Final = frozenset({"annotation", "returns", "type_comment", "type_params", "ctx", "kind"})


class Definition(NamedTuple):
    """A definition at the top of a module or of a class."""

    module: str
    name: str
    node: ast.stmt


@cache
def code_hash(roots: tuple[str, ...], method: str | None = None, without: tuple[str, ...] = ()) -> str:
    """Short hash of the code that ``roots`` depend on.

    Args:
        roots: where the work starts, "module:function" or "module:Class.method".
        method: of the simulation, or another solver of its linear system; ``ALL``: all of them count.
        without: classes, "module:Class", and methods, "module:Class.method", that are reached by name and never run.

    Call it from one thread only: CPython 3.11 cannot parse in two.
    """
    digest = hashlib.sha256()
    for text in sorted(_texts((*roots, *(method_roots(method) if method else ())), without)):
        digest.update(text.encode() + b"\n")
    return digest.hexdigest()[:16]


def method_roots(name: str) -> tuple[str, ...]:
    """Where the code of a method or solver begins, or of ``ALL``.

    Raises:
        KeyError: there is no such method or solver.
    """
    from probe_env.physics import methods

    known: dict[str, tuple[object, ...]] = {method: (value,) for method, value in methods.METHODS.items()}
    known |= {s: (methods.METHODS["newmark"], value) for s, value in methods.SOLVERS.items() if value is not None}
    wanted = dict.fromkeys(itertools.chain(*(known.values() if name == ALL else [known[name]])))
    modules = [module for key, module in sorted(sys.modules.items()) if key.startswith(f"{REGISTRY}.")]
    places = {id(value): f"{module.__name__}:{key}" for module in modules for key, value in vars(module).items()}
    return tuple(places[id(value)] for value in wanted)


def class_hash(kind: type, *methods: str) -> str:
    """Short hash of the code that methods of a class depend on; empty for a class that is not ours."""
    if kind.__module__.split(".")[0] not in PACKAGES:
        return ""
    return code_hash(tuple(f"{kind.__module__}:{kind.__qualname__}.{name}" for name in methods))


def _texts(roots: tuple[str, ...], without: tuple[str, ...] = ()) -> Iterator[str]:
    """Every reachable definition in its canonical form, its name first."""
    todo: list[Definition | None] = []
    names_used: set[str] = set()
    for root in roots:
        module, _, path = root.partition(":")
        name, _, used = path.partition(".")
        names_used |= {used} - {""}
        todo.append(_find(module, name))
        if todo[-1] is None:
            raise ValueError(f"root = {root!r}: there is no {name} in {module}")
    methods: dict[str, list[Definition]] = {}  # of reached classes, by name, that nothing has used yet
    seen: set[tuple[str, str]] = set()
    while todo:
        reached = todo.pop()
        if reached is None or _is_aside(reached.module) or (reached.module, reached.name) in seen:
            continue
        if f"{reached.module}:{reached.name}" in without:
            continue
        seen.add((reached.module, reached.name))
        parts: list[ast.AST] = [reached.node]
        if isinstance(reached.node, ast.ClassDef):
            parts = [*reached.node.decorator_list, *reached.node.bases, *reached.node.keywords]
            for member in reached.node.body:
                if isinstance(member, ast.FunctionDef) and member.name in SHOWN_BY:
                    continue
                if isinstance(member, ast.FunctionDef) and f"{reached.module}:{reached.name}.{member.name}" in without:
                    continue
                if isinstance(member, ast.FunctionDef) and not member.name.startswith("__"):
                    inner = Definition(reached.module, f"{reached.name}.{member.name}", member)
                    methods.setdefault(member.name, []).append(inner)
                else:
                    parts.append(member)
        yield _text(reached, tuple(parts))
        for part in parts:
            attributes, targets = _uses(part, reached.module)
            names_used |= attributes
            todo += targets
        for name in names_used & methods.keys():
            todo += methods.pop(name)


@cache  # stages have most of their code in common
def _text(reached: Definition, parts: tuple[ast.AST, ...]) -> str:
    """The canonical form of the parts of a definition that count, its name first."""
    names = _names_of_ours(reached, parts)
    texts = ("" if _is_place(part) else _canonical(part, names) for part in parts)
    return f"{reached.name} " + " ".join(filter(None, texts))


def _is_aside(module: str) -> bool:
    return module == REGISTRY or any(module == name or module.startswith(f"{name}.") for name in ASIDE)


@cache
def _uses(node: ast.AST, module: str) -> tuple[frozenset[str], tuple[Definition | None, ...]]:
    """Names of attributes and the definitions that a piece of code refers to."""
    attributes: set[str] = set()
    targets: list[Definition | None] = []
    local = _imports(list(ast.walk(node)))
    for part, counts in _walk(node):
        if isinstance(part, ast.Name):
            reached = _find(*local[part.id]) if part.id in local else _find(module, part.id)
            targets.append(reached if counts or (reached and isinstance(reached.node, ast.ClassDef)) else None)
        elif isinstance(part, ast.Attribute) and counts:
            attributes.add(part.attr)
            if isinstance(part.value, ast.Name):
                targets.append(_find_in_alias(module, part.value.id, part.attr))
        elif isinstance(part, ast.Constant) and counts and isinstance(part.value, str) and part.value.isidentifier():
            attributes.add(part.value)  # getattr(thing, "name")
    return frozenset(attributes), tuple(targets)


def _walk(node: ast.AST, counts: bool = True) -> Iterator[tuple[ast.AST, bool]]:
    """Everything in a piece of code, and whether it counts or only names a type."""
    yield node, counts
    for name, value in ast.iter_fields(node):
        inner = counts and name not in IGNORED_FIELDS
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_wording(child):
                yield from _walk(child, inner)


def _is_wording(node: ast.AST) -> bool:
    """Imports, docstrings and other bare strings, raised errors, checks, warnings, what is logged or printed.

    A check (``check_...`` or ``within``, its value not used) raises or does nothing.
    """
    if isinstance(node, ast.Import | ast.ImportFrom | ast.Raise):
        return True
    if not isinstance(node, ast.Expr):
        return False
    if isinstance(node.value, ast.Constant):
        return True
    called = node.value.func if isinstance(node.value, ast.Call) else None
    if isinstance(called, ast.Attribute):
        spoken = isinstance(called.value, ast.Name) and called.value.id in ("warnings", "logger", "logging")
        return spoken or called.attr.lstrip("_").startswith("check_")
    return isinstance(called, ast.Name) and (called.id in ("print", "within") or called.id.startswith("check_"))


def _names_of_ours(reached: Definition, parts: Iterable[ast.AST]) -> dict[str, tuple[str, str | None]]:
    """What the names in a definition that are imported stand for."""
    imported = {name: target for name, target in _module(reached.module).items() if isinstance(target, tuple)}
    return imported | _imports([node for part in parts for node in ast.walk(part)])


def _is_place(part: ast.AST) -> bool:
    """Whether a constant of a module or class is made of ``__file__``: an input, to be hashed as one.

    Within a function ``__file__`` is code like any other.
    """
    if not isinstance(part, ast.Assign | ast.AnnAssign) or part.value is None:
        return False
    return any(isinstance(inner, ast.Name) and inner.id == "__file__" for inner in ast.walk(part.value))


def _canonical(node: object, names: Mapping[str, tuple[str, str | None]]) -> str:
    """A piece of code as text that depends on neither Python's version nor how definitions are imported."""
    if isinstance(node, ast.AST):
        if _is_wording(node):
            return "raise" if isinstance(node, ast.Raise) else ""
        if isinstance(node, ast.JoinedStr):
            return f"f({' '.join(_canonical(v, names) for v in node.values if not isinstance(v, ast.Constant))})"
        if isinstance(node, ast.Name) and node.id in names:
            return f"Name(id={(names[node.id][1] or node.id)!r})"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            target = names.get(node.value.id)
            if target is not None and target[1] is None:  # an attribute of a module is a name like any other
                return f"Name(id={node.attr!r})"
        fields = ((name, _canonical(v, names)) for name, v in ast.iter_fields(node) if name not in IGNORED_FIELDS)
        return f"{type(node).__name__}({' '.join(f'{name}={text}' for name, text in fields if text)})"
    if isinstance(node, list):
        return ",".join(filter(None, (_canonical(entry, names) for entry in node)))
    return "" if node is None else repr(node)


@cache
def _module(name: str) -> dict[str, ast.stmt | tuple[str, str | None]]:
    """Top-level names of a module: their definition, or the module and name that they are imported from."""
    path = _path(name)
    if path is None:
        return {}
    statements: list[ast.stmt] = []
    todo = list(ast.parse(path.read_text()).body)
    while todo:
        statement = todo.pop(0)
        statements.append(statement)
        if isinstance(statement, ast.If | ast.Try):
            todo = [*statement.body, *statement.orelse, *todo]
    names: dict[str, ast.stmt | tuple[str, str | None]] = dict(_imports(statements))
    for statement in statements:
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            names[statement.name] = statement
        elif isinstance(statement, ast.Assign | ast.AnnAssign | ast.AugAssign):
            for target in statement.targets if isinstance(statement, ast.Assign) else [statement.target]:
                names |= {part.id: statement for part in ast.walk(target) if isinstance(part, ast.Name)}
    return names


def _imports(nodes: list[ast.AST] | list[ast.stmt]) -> dict[str, tuple[str, str | None]]:
    """What of our own packages is imported: name -> (module, name in it or None for the module itself)."""
    names: dict[str, tuple[str, str | None]] = {}
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in PACKAGES:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                names[alias.asname or alias.name] = (inner, None) if _path(inner) else (node.module, alias.name)
        elif isinstance(node, ast.Import):
            ours = (alias for alias in node.names if alias.name.split(".")[0] in PACKAGES)
            names |= {alias.asname or alias.name: (alias.name, None) for alias in ours}
    return names


@cache
def _path(module: str) -> Path | None:
    """The file of a module of ours; nothing is imported to find it."""
    package, *inner = module.split(".")
    spec = find_spec(package)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    place = Path(spec.submodule_search_locations[0], *inner)
    candidates = (place / "__init__.py", place.with_suffix(".py"))
    return next((path for path in candidates if path.is_file()), None)


def _find(module: str, name: str | None) -> Definition | None:
    """The definition behind a name, through imports; None for what is not ours."""
    target = _module(module).get(name) if name else None
    if isinstance(target, tuple):
        return _find(*target)
    return Definition(module, str(name), target) if target is not None else None


def _find_in_alias(module: str, alias: str, name: str) -> Definition | None:
    """The definition behind ``alias.name`` where the alias is a module."""
    target = _module(module).get(alias)
    return _find(target[0], name) if isinstance(target, tuple) and target[1] is None else None
