"""Names, modules and extras of the commands, and the first page of the help; imports no package, to be fast."""

import re
from importlib.metadata import requires
from typing import Final

GROUPS: Final = {
    "Simulate and evaluate": {
        "simulate": ("evaluation:Simulate", "one scene by any method: statistics, signals, figures"),
        "evaluate": ("evaluation:Evaluate", "policies and schedules on the same tubes, with a report"),
        "render": ("evaluation:Render", "animation of an insertion, or slow motion near the tip"),
        "signal": ("evaluation:Signal", "sensor signals of a run: X, Y, flaws, calls"),
        "agents": ("evaluation:Agents", "list trained agents and other policies"),
    },
    "Train and design": {
        "train": ("training:Train", "train agents from a training file, with checkpoints"),
        "compare": ("training:Compare", "probe designs on the same tubes"),
        "design": ("training:DesignSearch", "search for probe designs"),
        "study": ("training:Study", "run a study by name or from a file"),
    },
    "Your plant": {
        "log": ("plant:ReadLog", "read a rig's log and write it as a schedule"),
        "calibrate": ("plant:Calibrate", "estimate friction and other unknowns from logs"),
        "recommend": ("plant:Recommend", "schedule with the least hours or best reward for your plant"),
        "plc": ("plant:Plc", "for a PLC: recommended schedule and feedback law"),
        "app": ("plant:App", "edit, run and compare schedules in the browser"),
    },
}
"""Title -> name -> module of ``probe_agents.cli`` with dataclass, and the line on the first page."""
COMMANDS: Final = {name: entry for commands in GROUPS.values() for name, entry in commands.items()}
NEEDS: Final = {
    **dict.fromkeys(("train", "compare", "design"), "agents"),
    **dict.fromkeys(("log", "calibrate"), "plant"),
    "app": "app",
}
"""Commands that always need more than the extra ``commands`` -> their extra."""
FIRST_PAGE: Final = """usage: probe-env COMMAND [OPTIONS]

Feed control and probe design with a fast simulator of a long cable in a tube.

{commands}

Examples:
  probe-env evaluate ppo pi my-schedule.csv --limit 6
  probe-env simulate fig11_l30 --method imex --scene.contact.friction 0.2

probe-env COMMAND --help   options with their units, and an example
probe-env --version        the version"""


def first_page() -> str:
    """The help of ``probe-env``, in lines of at most 80 characters."""
    groups = (
        "\n".join((f"{title}:", *(f"  {name:11s}{text}" for name, (_, text) in commands.items())))
        for title, commands in GROUPS.items()
    )
    return FIRST_PAGE.format(commands="\n\n".join(groups))


EXTRAS: Final = ("commands", "plant", "agents", "app")
"""Extras of users, from small to large."""
PARTS: Final = {"plant": ("commands",), "agents": ("commands", "plant"), "app": ("commands",)}
"""Extra -> the extras that it includes."""
MODULES: Final = {
    "bokeh": ("bokeh", "tornado"), "imageio": ("imageio", "imageio_ffmpeg"), "jinja2": ("jinja2", "markupsafe"),
    "pillow": ("PIL",), "python-dateutil": ("dateutil",),
}  # fmt: skip
"""Package -> its modules, where they differ from the name of the package."""


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
