"""Tables and figures of the README and of docs/, made from stored results, so that neither can drift from the other.

A block of a page between ``<!-- NAME -->`` and ``<!-- /NAME -->`` belongs to the maker of that name in ``blocks``, and
stands on one page only: ``_pages``.
"""

from __future__ import annotations

import re
from pathlib import Path

from agents.learning import results as agent_results
from agents.pages.blocks import MAKERS, RESULTS
from agents.pages.control import reward_profiles
from agents.pages.trained import ALONE
from agents.records.provenance import write_atomically
from agents.study.back import load_rows as load_trips
from agents.study.cases import load_rows
from agents.study.claims import Ensemble
from agents.study.ways import ways_spectra

README, DOCS = Path("README.md"), Path("docs")


def rewrite_readme() -> None:
    """Rewrite every block and figure."""
    for page, names in _pages().items():
        write_atomically(page, _rewritten(page, names))
    _growth_figure(RESULTS / "study" / "growth.png")
    ways_spectra(load_trips(RESULTS / "study"), RESULTS / "study" / "back.png")
    _learning_figure(RESULTS / "agents" / "learning.png")
    _scratch_figure(RESULTS / "agents" / "scratch.png")
    _profile_figure(RESULTS / "agents" / "profiles.png")
    print("README.md and docs/ rewritten from results/")


def check_readme() -> None:
    """Raise ValueError if a block differs from what the stored results give."""
    for page, names in _pages().items():
        if _rewritten(page, names) != page.read_text():
            raise ValueError(f"{page} differs from the stored results: run `make readme`")
        print(f"{page} agrees with results/")


def _rewritten(page: Path, names: tuple[str, ...]) -> str:
    text = page.read_text()
    for name in names:
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        if len(pattern.findall(text)) != 1:
            raise ValueError(f"{page} must hold the block <!-- {name} --> ... <!-- /{name} --> exactly once")
        content = MAKERS[name]()
        text = pattern.sub(lambda match, content=content: f"{match[1]}{content}\n{match[2]}", text)  # type: ignore[misc]
    return text


def _growth_figure(path: Path) -> None:
    from agents.study.figures import length_against_vibration

    ensemble = Ensemble(load_rows(RESULTS / "study"))
    lengths = (10, 20, 30, 40, 50, 55)
    values = [ensemble.values(f"l{length}", "radial_rms_m") for length in lengths]
    low, middle, high = ([f(v) for v in values] for f in (min, lambda v: sum(v) / len(v), max))
    length_against_vibration(list(lengths), low, middle, high, path)


def _learning_figure(path: Path) -> None:
    from agents.learning.figures import learning_curves

    runs = {name: agent_results.load_curves(RESULTS / "agents" / name) for name in ("ppo", "ppo-no-tension", "student")}
    learning_curves(runs, path, "environment steps after the warm start")


def _scratch_figure(path: Path) -> None:
    from agents.learning.figures import learning_curves

    learning_curves({ALONE: agent_results.load_curves(RESULTS / "agents" / ALONE)}, path, "environment steps")


def _profile_figure(path: Path) -> None:
    from agents.learning.figures import performance_profiles

    performance_profiles(reward_profiles(), path)


def _pages() -> dict[Path, tuple[str, ...]]:
    """The blocks of every page."""
    results = DOCS / "results"
    return {
        README: ("headline",),
        results / "evaluation.md": ("map_quality", "evaluation", "any_probe"),
        results / "agents.md": ("agents", "student", "student_fresh", "student_finely", "student_scheme", "scratch"),
        results / "designs.md": ("search", "designs", "codesign"),
        results / "fronts.md": ("tradeoff", "tradeoff_found", "fidelity"),
        results / "study.md": ("study", "back"),
        results / "speed.md": ("bench", "environments", "presets"),
        DOCS / "accuracy.md": ("smooth", "outputs", "choices", "timelapse", "stability", "energy", "peers"),
        DOCS / "simulation" / "return.md": ("feed_changes", "idle_cable", "pressed_scenes", "lost_insertions"),
        DOCS / "superelement.md": ("superelement", "other_probes"),
        DOCS / "simulation" / "root.md": ("root",),
        DOCS / "cluster.md": ("scaling",),
        DOCS / "inspection" / "calibration.md": ("calibrations", "recommendations"),
        DOCS / "inspection" / "plc.md": ("plc_reached", "plc_fresh", "plc_finely", "plc_constants", "trim", "plc_text"),
        DOCS / "inspection" / "signal.md": (
            "as_seen",
            "false_calls",
            "anchors",
            "snr",
            "snr_agent",
        ),
        results / "heard.md": (
            "hearing",
            "hearing_fresh",
            "hearing_along",
            "steady_along",
            "hearing_steady",
            "replays",
        ),
        DOCS / "inspection" / "passes.md": ("passes", "turning", "passes_search", "passes_acting"),
        DOCS / "learning" / "headroom.md": ("headroom", "headroom_finely", "planner_settings"),
        DOCS / "learning" / "world.md": ("world",),
        DOCS / "inspection" / "robustness.md": ("robustness",),
        DOCS / "inspection" / "tube.md": ("plants",),
        DOCS / "inspection" / "app.md": ("answers",),
    }
