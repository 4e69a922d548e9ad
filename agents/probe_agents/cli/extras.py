"""Finds the extra of the package that installs a missing module; standard library only."""

from __future__ import annotations

import re
from importlib.metadata import requires
from typing import Final

EXTRAS: Final = ("commands", "plant", "agents", "app")
"""Extras of users, from small to large."""
MODULES: Final = {
    "bokeh": ("bokeh", "tornado"), "imageio": ("imageio", "imageio_ffmpeg"), "jinja2": ("jinja2", "markupsafe"),
    "pillow": ("PIL",), "python-dateutil": ("dateutil",),
}  # fmt: skip
"""Package -> its modules, where they differ from the name of the package."""


PARTS: Final = {"plant": ("commands",), "agents": ("commands", "plant"), "app": ("commands",)}
"""Extra -> the extras that it includes."""


def extra_with(module: str, needed: str = "commands") -> str | None:
    """The smallest extra that installs a module and includes the extra ``needed``; None if no extra has the module.

    If none has both, the smallest one with the module.
    """
    extra = next((extra for extra in EXTRAS if module in modules_of(extra)), None)
    return needed if extra in PARTS.get(needed, ()) else extra


def modules_of(extra: str = "") -> set[str]:
    """Modules of the packages of an extra; without an extra, those of the basic install."""
    modules: set[str] = set()
    for requirement in requires("probe-env") or []:
        marker = re.search(r"""extra\s*==\s*['"]([\w-]+)['"]""", requirement)
        package = re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")
        if (marker[1] if marker else "") == extra:
            modules.update(MODULES.get(package, (package.replace("-", "_"),)))
    return modules - {"probe_env"}
