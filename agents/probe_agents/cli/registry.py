"""Names and modules of the commands, and the first page of the help; imports no package, to be fast."""

from __future__ import annotations

from typing import Final

COMMANDS: Final = {
    "simulate": ("evaluation:Simulate", "one scene by any method: statistics, signals, figures"),
    "evaluate": ("evaluation:Evaluate", "policies and schedules on the same tubes, with a report"),
    "render": ("evaluation:Render", "animation of an insertion, or slow motion near the tip"),
    "signal": ("evaluation:Signal", "sensor signals of a run: X, Y, flaws, calls"),
    "agents": ("evaluation:Agents", "list trained agents and other policies"),
    "train": ("training:Train", "train agents from a training file, with checkpoints"),
    "tune": ("training:Tune", "search hyperparameters"),
    "compare": ("training:Compare", "probe designs on the same tubes"),
    "design": ("training:DesignSearch", "search for probe designs"),
    "log": ("plant:ReadLog", "read a rig's log and write it as a schedule"),
    "calibrate": ("plant:Calibrate", "estimate friction and other unknowns from logs"),
    "recommend": ("plant:Recommend", "schedule with the best expected reward for your plant"),
    "plc": ("plant:Plc", "for a PLC: recommended schedule and feedback law"),
    "app": ("plant:App", "edit, run and compare schedules in the browser"),
    "study": ("training:Study", "run a study by name or from a file"),
}
"""Name -> module of ``probe_agents.cli`` with dataclass, and the line on the first page."""
NEEDS: Final = {
    **dict.fromkeys(("train", "tune", "compare", "design"), "agents"),
    **dict.fromkeys(("log", "calibrate"), "plant"),
    "app": "app",
}
"""Commands that always need more than the extra ``commands`` -> their extra."""
GROUPS: Final = {
    "Simulate and evaluate": ("simulate", "evaluate", "render", "signal", "agents"),
    "Train and design": ("train", "tune", "compare", "design", "study"),
    "Your plant": ("log", "calibrate", "recommend", "plc", "app"),
}
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
        "\n".join((f"{title}:", *(f"  {name:11s}{COMMANDS[name][1]}" for name in names)))
        for title, names in GROUPS.items()
    )
    return FIRST_PAGE.format(commands="\n\n".join(groups))
