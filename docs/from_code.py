"""What pages take from the code at build time: docstrings, fields with their ranges, methods.

A line ``<!-- from code: WHAT NAME -->`` of a page is replaced by what the function ``WHAT`` says of ``NAME``.
"""

import inspect
import math
import re
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from typing import Any, Final

import numpy.typing as npt
from sphinx.application import Sphinx
from sphinx.util.typing import stringify_annotation

from probe_env import Scene
from probe_env.physics.methods import METHODS
from probe_env.settings import Model, range_of

PLACE: Final = re.compile(r"^<!-- from code: (\w+)(?: ([\w.]+))? -->$", re.MULTILINE)
NDARRAY: Final = re.compile(
    r"~numpy\.ndarray\[tuple\[~typing\.Any, \.\.\.\], ~numpy\.dtype\[(~[\w.]+)(?:\[~typing\.Any\])?\]\]"
)
ARRAY_LIKE: Final = stringify_annotation(npt.ArrayLike, "smart")
"""How autodoc writes types of arrays, which are short in the source."""


def docstring(name: str) -> str:
    """A docstring in Markdown, its headings one level below those of the page's sections."""
    return re.sub(r"^##", "###", inspect.getdoc(_found(name)) or "", flags=re.MULTILINE)


def fields(name: str) -> str:
    """The fields of a model: default, unit, accepted range and meaning."""
    model = _found(name)
    rows = []
    for field, info in model.model_fields.items():
        default = info.default
        shown = f"`{type(default).__name__}()`" if isinstance(default, Model) else f"`{_short(default)}`"
        known = range_of(model, field)
        accepted = f"{known.low:g} to {known.high:g}" if known else _kind(info.annotation)
        meaning = " ".join((info.description or "").split())
        rows.append((f"`{field}`", shown, (known and known.unit) or "-", accepted, meaning))
    return _table(("field", "default", "unit", "accepted", "meaning"), rows)


def methods() -> str:
    """Order, steps and lanes of every method, for table 2's probe."""
    scene, rows = Scene(), []
    for method in METHODS.values():
        stable, contact = (limit(scene, 4) for limit in (method.stable_step, method.contact_step))
        steps = [f"{step:.2g} s" if math.isfinite(step) else "any" for step in (stable, contact)]
        minimum = f"{method.min_step:g} s" if method.min_step else "-"
        usual = f"{method.usual_step:g} s"
        rows.append((f"`{method.name}`", str(method.order), usual, *steps, minimum, str(method.width)))
    header = "method,order,usual step,known to hold up to,contact allows,at least,probes side by side"
    return _table(header.split(","), rows)


MAKERS: Final[dict[str, Callable[..., str]]] = {f.__name__: f for f in (docstring, fields, methods)}


def _found(name: str) -> Any:
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(module), attribute)


def _kind(annotation: Any) -> str:
    """What is accepted where no range is: choices, or a type."""
    choices = getattr(annotation, "__args__", ())
    if choices and all(isinstance(choice, str) for choice in choices):
        return ", ".join(f"`{choice}`" for choice in choices)
    if inspect.isclass(annotation) and not choices:
        return f"`{annotation.__name__}`"
    above = re.search(r"Optional\[.*Annotated\[(\w+), .*Gt\(gt=(.+?)\)", str(annotation))
    if above:
        return f"`{above[1]}` above {above[2]}, or `None`"
    return f"`{re.sub(r'[A-Za-z_]+[.]', '', str(annotation))}`".replace("|", "or")


def _short(value: Any) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(map(_short, value))})"
    return f"{value:.4g}" if isinstance(value, float) else repr(value)


def _table(header: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _expand(app: Sphinx, document: str, source: list[str]) -> None:
    """Replace the placeholders of a page."""

    def filled(match: re.Match[str]) -> str:
        what, name = match.groups()
        return MAKERS[what](name) if name else MAKERS[what]()

    source[0], count = PLACE.subn(filled, source[0])
    if count:
        app.env.note_reread()


def _signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Models take their fields by name, whose ranges stand in tables; aliases of types are named as in the source."""
    if inspect.isclass(obj) and issubclass(obj, Model):
        return "(**fields)", None
    return _plain(signature), _plain(returns)


def _plain(text: str | None) -> str | None:
    return NDARRAY.sub(r"~numpy.typing.NDArray[\1]", text.replace(ARRAY_LIKE, "ArrayLike")) if text else text


def setup(app: Sphinx) -> dict[str, Any]:
    """Take part in the build."""
    app.connect("source-read", _expand)
    app.connect("autodoc-process-signature", _signature)
    return {"parallel_read_safe": True}
