"""The 15 commands: where each is, a line on it, and an example. Imports nothing, so that help is printed at once."""

from __future__ import annotations

from typing import Final, NamedTuple


class Entry(NamedTuple):
    """A command.

    Attributes:
        target: module of ``agents.cli`` and dataclass in it.
        summary: one line for the first page.
        example: of its use.
    """

    target: str
    summary: str
    example: str


COMMANDS: Final = {
    "simulate": Entry(
        "simulate:Simulate",
        "one scene by any method: statistics, signals, figures",
        "probe-env simulate fig11_l30 --method imex --scene.contact.friction 0.2",
    ),
    "evaluate": Entry(
        "evaluation:Evaluate",
        "policies and schedules on the same tubes, with a report",
        "probe-env evaluate ppo pi my-schedule.csv --limit 6 --fidelity fast",
    ),
    "render": Entry(
        "evaluation:Render",
        "film of an insertion, or slow motion near the tip",
        "probe-env render --policy ppo --fidelity fast --output output/ppo.gif",
    ),
    "signal": Entry(
        "evaluation:Signal",
        "sensor signals of a run: X, Y, flaws, calls",
        "probe-env signal best-schedule --flaws 10:20 30:20 50:40",
    ),
    "agents": Entry("evaluation:Agents", "list trained agents and other policies", "probe-env agents"),
    "train": Entry(
        "training:Train",
        "train agents from a training file, with checkpoints",
        "probe-env train ppo --seeds 7 --output output/train/mine",
    ),
    "tune": Entry(
        "training:Tune",
        "search hyperparameters",
        "probe-env tune ppo --trials 40 --phases 2 --output output/tune/ppo",
    ),
    "compare": Entry(
        "design:Compare",
        "probe designs on the same tubes",
        "probe-env compare original improved my-design.toml --limit 6",
    ),
    "design": Entry(
        "design:DesignSearch", "search for probe designs", "probe-env design --trials 100 --limit 6 --jobs 2"
    ),
    "log": Entry(
        "plant:ReadLog",
        "read a rig's log and write it as a schedule",
        "probe-env log rig.csv --columns 'Vorschub [mm/s]=feed_speed' --plot output/rig.png",
    ),
    "calibrate": Entry(
        "plant:Calibrate",
        "estimate friction and other unknowns from logs",
        "probe-env calibrate rig.csv --tube mine.toml --output output/calibration",
    ),
    "recommend": Entry(
        "plant:Recommend",
        "schedule with the best expected reward for your plant",
        "probe-env recommend my-schedule.csv --tube mine.toml --output output/mine.csv",
    ),
    "plc": Entry(
        "plant:Plc",
        "feedback law for a PLC: structured text or table",
        "probe-env plc --st output/law.st --csv output/law.csv --tube mine.toml",
    ),
    "app": Entry("app:App", "drag, run, watch and compare schedules in the browser", "probe-env app --tube mine.toml"),
    "study": Entry(
        "studies:Study", "run a study by name or file; make shipped data again", "probe-env study robustness --limit 2"
    ),
}
GROUPS: Final = {
    "Simulate and evaluate": ("simulate", "evaluate", "render", "signal", "agents"),
    "Train and design": ("train", "tune", "compare", "design", "study"),
    "Your plant": ("log", "calibrate", "recommend", "plc", "app"),
}


def first_page() -> str:
    """The help of ``probe-env`` itself, in lines of fewer than 80 characters."""
    lines = [
        "usage: probe-env COMMAND [OPTIONS]",
        "",
        "Feed control and probe design around a fast simulator of a long cable in a tube.",
    ]
    for title, names in GROUPS.items():
        lines += ["", f"{title}:", *(f"  {name:11s}{COMMANDS[name].summary}" for name in names)]
    lines += [
        "",
        "Examples:",
        *(f"  {COMMANDS[name].example}" for name in ("evaluate", "simulate")),
        "",
        "probe-env COMMAND --help   options with their units, and an example",
        "probe-env --version        the version",
    ]
    return "\n".join(lines)
