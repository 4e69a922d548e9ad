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


def extra_with(module: str) -> str | None:
    """The smallest extra that installs a module; None if there is none."""
    return next((extra for extra in EXTRAS if module in modules_of(extra)), None)


def modules_of(extra: str = "") -> set[str]:
    """Modules of the packages of an extra; without an extra, those of the basic install."""
    modules: set[str] = set()
    for requirement in requires("probe-env") or []:
        marker = re.search(r"""extra\s*==\s*['"]([\w-]+)['"]""", requirement)
        package = re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")
        if (marker[1] if marker else "") == extra:
            modules.update(MODULES.get(package, (package.replace("-", "_"),)))
    return modules - {"probe_env"}
