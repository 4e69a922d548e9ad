"""All commands: where each is, what it does in a line and how it is used. Light: nothing is loaded to print this."""

from __future__ import annotations

from typing import Final, NamedTuple


class Entry(NamedTuple):
    """A command.

    Attributes:
        place: module of ``agents.commands`` and dataclass in it.
        tells: what it does, for the first page.
        example: how it is used.
    """

    place: str
    tells: str
    example: str


FIRST: Final = {
    "simulate": Entry(
        "study:Simulate", "one scene by any method: statistics, signals and figures",
        "probe-env simulate fig11_l30 --method imex --scene.contact.friction 0.2",
    ),
    "evaluate": Entry(
        "feed:Evaluate", "feed policies on the same tubes: figures, a report",
        "probe-env evaluate ppo pi my-schedule.csv --limit 6 --fidelity fast",
    ),
    "render": Entry(
        "feed:Render", "a film of an insertion, or slow motion near the tip",
        "probe-env render --policy ppo --fidelity fast --output output/ppo.gif",
    ),
    "train": Entry(
        "training:Train", "agents after a training file, with checkpoints",
        "probe-env train ppo --seeds 7 --output output/train/mine",
    ),
    "compare": Entry(
        "design:Compare", "probe designs on the same tubes under one feed",
        "probe-env compare original improved my-design.toml --limit 6",
    ),
    "design": Entry(
        "design:DesignSearch", "a search for better probes",
        "probe-env design --trials 100 --limit 6 --jobs 2",
    ),
}  # fmt: skip
"""What the project is for."""
PLANT: Final = {
    "app": Entry(
        "app:App", "a page to drag a schedule, run it, watch the probe, compare", "probe-env app --tube mine.toml"
    ),
    "log": Entry(
        "log:ReadLog", "a rig's log, read, shown and made a schedule of",
        "probe-env log rig.csv --columns 'Vorschub [mm/s]=feed_speed' --plot output/rig.png",
    ),
    "calibrate": Entry(
        "plant:Calibrate", "friction and the rest of your plant from its logs",
        "probe-env calibrate rig.csv --tube mine.toml --output output/calibration",
    ),
    "recommend": Entry(
        "plant:Recommend", "the schedule with the best expected reward for your plant",
        "probe-env recommend my-schedule.csv --tube mine.toml --output output/mine.csv",
    ),
    "plc": Entry(
        "control:Plc", "a feedback law of ten constants, for your plant's PLC",
        "probe-env plc --st output/law.st --csv output/law.csv --tube mine.toml",
    ),
    "signal": Entry(
        "inspection:Signal", "a run as inspection shows it: X, Y, flaws, calls",
        "probe-env signal best-schedule --flaws 10:20 30:20 50:40",
    ),
    "tune": Entry(
        "training:Tune", "a search for better hyperparameters of such a file",
        "probe-env tune ppo --trials 40 --phases 2 --output output/tune/ppo",
    ),
}  # fmt: skip
"""What a plant of one's own needs, and more."""
USERS: Final = FIRST | PLANT
MAKERS: Final = {
    "report": Entry("feed:Report", "the report of a stored evaluation, again", "probe-env report output/evaluation"),
    "tradeoff": Entry(
        "feed:Tradeoff", "time against vibration, over one parameter of each policy",
        "probe-env tradeoff constant pi --beside ppo --limit 6",
    ),
    "robustness": Entry(
        "robustness:Robustness", "what policies lose in tasks that they were not made for",
        "probe-env robustness best-schedule ppo --limit 6",
    ),
    "map": Entry("feed:Map", "how loud a probe is where, which policies look up", "probe-env map --seeds 1"),
    "optimise": Entry(
        "feed:Optimise", "the best schedules by that map", "probe-env optimise best-schedule --trials 200"
    ),
    "optimise-passes": Entry(
        "plant:OptimisePasses", "the best feed and air in and back, by simulation",
        "probe-env optimise-passes --tube mine.toml --trials 20 --limit 6",
    ),
    "response": Entry(
        "plant:Learn", "what calibrations and recommendations go by", "probe-env response --groups 2"
    ),
    "calibrations": Entry(
        "plant:Calibrations", "calibrations of logs whose truth is known", "probe-env calibrations --logs 8"
    ),
    "recommendations": Entry(
        "plant:Recommendations", "recommendations for tubes whose truth is known", "probe-env recommendations --tubes 8"
    ),
    "plants": Entry("plant:Plants", "policies in other bores and lengths", "probe-env plants --limit 2"),
    "anchors": Entry(
        "inspection:Anchors", "which policy finds smaller flaws, whatever the sensor's scale",
        "probe-env anchors constant best-schedule --limit 6",
    ),
    "false-calls": Entry(
        "inspection:FalseCalls", "whether noise is called as seldom as was promised",
        "probe-env false-calls best-schedule --limit 2",
    ),
    "world": Entry(
        "control:World", "the map as a world to train in, and its error", "probe-env world --limit 12"
    ),
    "headroom": Entry(
        "control:Headroom", "what feedback can still win: planners beside policies",
        "probe-env headroom tension-scheduled ppo --limit 6",
    ),
    "passes": Entry("plant:Passes", "where to look: on the way in, back, or both", "probe-env passes --limit 6"),
    "turning": Entry("plant:Turning", "how gently the feed has to turn round", "probe-env turning --limit 6"),
    "feed-changes": Entry(
        "plant:FeedChanges", "what a change of the feed on the way back does", "probe-env feed-changes"
    ),
    "study": Entry("study:Study", "the study's scenes and claims", "probe-env study --subset --members 2 --jobs 2"),
    "chart": Entry("study:Chart", "accuracy against cost of every method", "probe-env chart --output output/chart"),
    "other-probes": Entry(
        "study:OtherProbes", "whether the usual mesh holds for other probes", "probe-env other-probes --limit 1"
    ),
    "stability": Entry("study:Stability", "which time steps hold", "probe-env stability --output output/stability"),
    "pressed": Entry("study:Pressed", "which pressed scenes and steps hold", "probe-env pressed scenes --limit 20"),
    "timelapse": Entry("study:Timelapse", "what time-lapse changes", "probe-env timelapse --output output/timelapse"),
    "peers": Entry("study:Peers", "other packages beside this one", "probe-env peers --output output/chart"),
    "bench": Entry("study:Bench", "the kernels' speed", "probe-env bench --repeats 3"),
    "scaling": Entry("study:Scaling", "what more cores bring", "probe-env scaling --output output/scaling"),
}  # fmt: skip
"""What the results and the documents are made with."""
LISTS: Final = {
    "agents": Entry("feed:Agents", "trained agents and other policies that have a name", "probe-env agents"),
}
COMMANDS: Final = USERS | LISTS | MAKERS


def first_page() -> str:
    """The help of ``probe-env`` itself, in lines of fewer than 80 characters."""
    width = max(map(len, COMMANDS)) + 2
    groups = (
        ("First", FIRST),
        ("For your plant, and more", PLANT),
        ("For makers of the project's own results", MAKERS),
    )
    lines = [
        "usage: probe-env COMMAND [OPTIONS]",
        "",
        "Feed control and probe design around a fast simulator of a long cable in a tube.",
    ]
    for title, entries in groups:
        lines += ["", f"{title}:", *(f"  {name:{width}s}{entry.tells}" for name, entry in entries.items())]
    lines += [
        "",
        "Examples:",
        *(f"  {USERS[name].example}" for name in ("evaluate", "simulate")),
        "",
        "probe-env COMMAND --help   options with their units, and an example",
        f"probe-env agents           {LISTS['agents'].tells}",
        "probe-env --version        the version",
    ]
    return "\n".join(lines)
