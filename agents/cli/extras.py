"""Which extra of the package brings what is not installed. Standard library only: it must say so without them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
from typing import Final

DISTRIBUTION: Final = "probe-env"
EXTRAS: Final = ("commands", "plant", "agents", "app")
"""Extras of users, the smallest first."""
MODULES: Final = {
    "bokeh": ("bokeh", "tornado"), "imageio": ("imageio", "imageio_ffmpeg"), "jinja2": ("jinja2", "markupsafe"),
    "pillow": ("PIL",),
}  # fmt: skip
"""What is imported of packages whose modules have other names than they, or which bring others that we import."""
_REQUIREMENT: Final = re.compile(r"([\w.-]+)(\[[^]]*\])?")
_OF_EXTRA: Final = re.compile(r"""extra\s*==\s*['"]([\w-]+)['"]""")


def extra_with(module: str) -> str | None:
    """The extra that brings a module; None if none does."""
    return next((extra for extra in EXTRAS if module in modules_of(extra)), None)


def modules_of(extra: str) -> tuple[str, ...]:
    """The modules that an extra brings beyond ``commands``, which the others require and repeat when they are built."""
    smaller = () if extra == EXTRAS[0] else packages_of(EXTRAS[0])
    return modules_in(name for name in packages_of(extra) if name not in smaller)


def modules_in(packages: Iterable[str]) -> tuple[str, ...]:
    """What is imported of packages."""
    return tuple(name for package in packages for name in MODULES.get(package, (package.replace("-", "_"),)))


@lru_cache
def packages_of(extra: str = "") -> tuple[str, ...]:
    """The packages that an extra names; without one, those of a plain install."""
    return tuple(sorted({name for name in map(_package, _requirements(extra)) if name != DISTRIBUTION}))


def _requirements(extra: str) -> list[str]:
    """As the installed package says, else as the checkout's ``pyproject.toml`` does."""
    try:
        listed = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
        return list(project["optional-dependencies"][extra] if extra else project["dependencies"])
    markers = ((line, _OF_EXTRA.search(line)) for line in listed)
    return [line for line, marker in markers if (marker[1] if marker else "") == extra]


def _package(requirement: str) -> str:
    match = _REQUIREMENT.match(requirement)
    assert match is not None
    return match[1].lower().replace("_", "-")
