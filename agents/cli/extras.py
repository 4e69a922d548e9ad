"""Extra of the package that brings a missing module; standard library only, as nothing else may be installed."""

from __future__ import annotations

import re
from importlib.metadata import requires
from typing import Final

EXTRAS: Final = ("commands", "plant", "agents", "app")
"""Extras of users, the smallest first."""
MODULES: Final = {
    "bokeh": ("bokeh", "tornado"), "imageio": ("imageio", "imageio_ffmpeg"), "jinja2": ("jinja2", "markupsafe"),
    "pillow": ("PIL",),
}  # fmt: skip
"""Modules of packages that have other names, or bring other modules that are imported here."""


def extra_with(module: str) -> str | None:
    """The smallest extra that brings a module; None if none does."""
    return next((extra for extra in EXTRAS if module in modules_of(extra)), None)


def modules_of(extra: str = "") -> set[str]:
    """Modules of the packages that an extra requires; without one, those of a plain install."""
    modules: set[str] = set()
    for requirement in requires("probe-env") or []:
        marker = re.search(r"""extra\s*==\s*['"]([\w-]+)['"]""", requirement)
        package = re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")
        if (marker[1] if marker else "") == extra:
            modules.update(MODULES.get(package, (package.replace("-", "_"),)))
    return modules - {"probe_env"}
