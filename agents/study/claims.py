"""The study's claims beside what the simulator gives, judged on an ensemble table."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import mannwhitneyu

from agents.terminal.tables import print_table
from probe_env import Scene
from probe_env.physics.closed_forms import steady_root_tension

SIGNIFICANCE = 0.05
RMS = ("radial_rms_m", "axial_rms_m")


@dataclass(frozen=True)
class Finding:
    """One line of the table."""

    claim: str
    figure: str
    result: str
    verdict: str


class Ensemble:
    """Access to the members of an ensemble table by case and statistic."""

    def __init__(self, table: pd.DataFrame) -> None:
        self.table = table

    def has(self, *cases: str) -> bool:
        """Whether every case has at least one member."""
        return set(cases) <= set(self.table["case"])

    def values(self, case: str, statistic: str) -> np.ndarray:
        """One statistic of all members of a case, diverged ones as NaN."""
        return self.table.loc[self.table["case"] == case, statistic].to_numpy(dtype=float)

    def mean(self, case: str, statistic: str = "radial_rms_m") -> float:
        """Mean over the members."""
        return float(np.mean(self.values(case, statistic)))

    def greater(self, large: str, small: str, statistic: str = "radial_rms_m") -> bool:
        """Whether one case lies above another: one-sided Mann-Whitney test, or plainly if too few members."""
        a, b = self.values(large, statistic), self.values(small, statistic)
        if min(len(a), len(b)) < 4:
            return bool(a.mean() > b.mean())
        return bool(mannwhitneyu(a, b, alternative="greater").pvalue < SIGNIFICANCE)

    def mm(self, case: str, statistic: str = "radial_rms_m") -> str:
        """Mean with the range of the members, in millimetres."""
        values = self.values(case, statistic) * 1e3
        if len(values) == 1:
            return short(values[0])
        return f"{short(values.mean())} ({short(values.min())}-{short(values.max())})"


def short(value: float) -> str:
    """Two digits, or all before the point."""
    return f"{value:.2g}" if abs(value) < 10.0 else f"{value:.0f}"


def _growth(e: Ensemble) -> Iterator[Finding]:
    cases = [name for name in ("l10", "l20", "l30", "l40", "l50", "l55") if e.has(name)]
    if len(cases) < 2:
        return
    pairs = [(a, b) for a, b in (("l10", "l30"), ("l20", "l40"), ("l30", "l50")) if e.has(a, b)]
    holds = all(e.greater(b, a) for a, b in pairs)
    rms = ", ".join(f"{e.mean(name) * 1e3:.2g}" for name in cases)
    lengths = ", ".join(name[1:] for name in cases)
    yield Finding(
        "vibration grows with length",
        "11",
        f"radial rms {rms} mm at l = {lengths} m",
        "yes" if holds else "no",
    )
    if len(cases) == 6:
        ratios = [e.mean(b) / e.mean(a) for a, b in itertools.pairwise(cases)]
        sharpest = int(np.argmax(ratios))
        result = f"sharpest from {cases[sharpest][1:]} to {cases[sharpest + 1][1:]} m: {ratios[sharpest]:.1f} times"
        beyond = f"; 30 to 40 m: {ratios[2]:.1f} times"
        yield Finding(
            "it rises sharply between 30 and 40 m",
            "11",
            result + beyond,
            "yes" if sharpest == 2 else "earlier",
        )


def _feed_and_tube(e: Ensemble) -> Iterator[Finding]:
    def compare(claim: str, figure: str, large: str, small: str) -> Finding:
        result = f"radial rms {e.mm(small)} against {e.mm(large)} mm"
        return Finding(claim, figure, result, "yes" if e.greater(large, small) else "not clearly")

    if e.has("u0", "l50"):
        still = e.values("u0", "radial_rms_m").max()
        quiet = still < 0.01 * e.mean("l50")
        result = f"radial rms {still * 1e3:.1g} mm in the last third"
        yield Finding("no vibration without feed", "15", result, "yes" if quiet else "no")
    if e.has("u100", "l50"):
        yield compare("less at 0.1 m/s", "16", "l50", "u100")
    if e.has("u400", "l50"):
        yield compare("more at 0.4 m/s", "16", "u400", "l50")
    if e.has("dh2500", "l50"):
        yield compare("less in a helix of 2.5 m", "17", "l50", "dh2500")
    if e.has("q40", "l50"):
        yield compare("less at 40 m3/h: displacement", "18", "l50", "q40")
        key = "radial_acceleration_rms_m_per_s2"
        result = f"{e.mean('q40', key):.0f} against {e.mean('l50', key):.0f} m/s2 (1 kHz)"
        holds = "yes" if e.greater("l50", "q40", key) else "not clearly"
        yield Finding("less at 40 m3/h: acceleration, as measured in the experiment", "18", result, holds)


def _spectrum_and_design(e: Ensemble) -> Iterator[Finding]:
    if e.has("l55"):
        common, axial = (float(np.median(e.values("l55", f"{name}_peak_hz"))) for name in ("common", "axial"))
        holds = abs(common - 14.0) <= 2.0 and abs(axial - common) <= 1.0
        result = f"median peaks: axial {axial:.1f} Hz, axial-radial cross-spectrum {common:.1f} Hz"
        yield Finding("one axial and radial peak at 14 Hz, l = 55 m", "14", result, "yes" if holds else "no")
    if e.has("improved", "l50"):
        ratio = e.mean("l50") / e.mean("improved")
        result = f"radial rms {e.mm('improved')} against {e.mm('l50')} mm: {ratio:.0f} times less"
        yield Finding("the improved probe is nearly silent, l = 50 m", "20", result, "yes" if ratio >= 5.0 else "no")


def _method(e: Ensemble) -> Iterator[Finding]:
    if e.has("l10-wilson", "l10", "l50-wilson", "l50"):
        overlap = not (e.greater("l50-wilson", "l50") or e.greater("l50", "l50-wilson"))
        result = (
            f"axial mean {e.mean('l10-wilson', 'axial_mean_m') * 1e3:.3f} and {e.mean('l10', 'axial_mean_m') * 1e3:.3f}"
            f" mm at 10 m; radial rms {e.mm('l50-wilson')} and {e.mm('l50')} mm at 50 m"
        )
        yield Finding("Wilson and Newmark agree", "-", result, "yes" if overlap else "no")
    if e.has("l50-dt2e-4", "l50-dt5e-4"):
        holds = bool(np.isnan(e.values("l50-dt2e-4", "diverged_at_s")).all())
        broken = np.isfinite(e.values("l50-dt5e-4", "diverged_at_s"))
        result = f"2e-4 s {'holds' if holds else 'diverges'}; 5e-4 s diverges in {broken.sum()} of {len(broken)}"
        yield Finding("diverges above a step of 1e-4 s", "-", result, "no, above 4e-4 s" if holds else "yes")


def _ours(e: Ensemble) -> Iterator[Finding]:
    steps = {"imex": "2e-4", "imex32": "2e-4", "explicit": "5e-6", "implicit": "2.5e-5"}
    for (method, step), length in itertools.product(steps.items(), ("l30", "l50")):
        name, acceleration = f"{length}-{method}", "radial_acceleration_rms_m_per_s2"
        if e.has(name, length):
            radial, axial, shake = (e.mean(name, key) / e.mean(length, key) for key in (*RMS, acceleration))
            result = (
                f"radial rms {e.mm(name)} against {e.mm(length)} mm; axial rms {axial:.2f},"
                f" acceleration {shake:.2f} times Newmark's"
            )
            agrees = "yes" if abs(radial - 1.0) < 0.15 and abs(axial - 1.0) < 0.1 else "not clearly"
            claim = f"(ours) {method} at {step} s has the statistics of Newmark at 1e-4 s, l = {length[1:]} m"
            yield Finding(claim, "-", result, agrees)
    if e.has("l30-offset", "l30", "l30-imex-offset", "l30-imex"):
        result = f"radial rms {e.mm('l30-offset')} against {e.mm('l30')} mm; imex {e.mm('l30-imex-offset')}"
        louder = e.greater("l30-offset", "l30") and e.greater("l30-imex-offset", "l30-imex")
        claim = "(ours) a root half a pitch from a float's place rings more, l = 30 m"
        yield Finding(claim, "-", result, "yes" if louder else "no")


def _walls_and_tension(e: Ensemble, scenes: Path) -> Iterator[Finding]:
    cases = [name for name in ("l30", "l50") if e.has(name)]
    if cases:
        mean = [e.mean(name, "root_tension_mean_n") for name in cases]
        exact = [steady_root_tension(Scene.from_toml(scenes / f"fig11_{name}.toml")) for name in cases]
        rows = zip(cases, mean, exact, strict=True)
        result = "; ".join(f"{name[1:]} m: {ours:.2f} against {closed:.2f} N" for name, ours, closed in rows)
        close = "yes" if np.allclose(mean, exact, rtol=0.01) else "no"
        yield Finding("(ours) mean root tension is that of steady sliding", "-", result, close)
    if e.has("l50-inner", "l50"):
        one, two = e.mm("l50-inner", "tip_radial_max_m"), e.mm("l50", "tip_radial_max_m")
        wild = e.mean("l50-inner", "tip_radial_max_m") > 24.2e-3
        result = f"tip off the inner wall by {one} mm; with both walls {two}"
        yield Finding("only the inner wall is touched", "5", result, "not by the tip" if wild else "yes")


def findings(table: pd.DataFrame, scenes: Path = Path("configs/scenes")) -> list[Finding]:
    """Every claim that the cases in the table can answer; ``scenes`` holds the scene files."""
    e = Ensemble(table)
    return [
        *_growth(e),
        *_feed_and_tube(e),
        *_spectrum_and_design(e),
        *_method(e),
        *_ours(e),
        *_walls_and_tension(e, scenes),
    ]


def print_findings(outcomes: list[Finding], table: pd.DataFrame) -> None:
    """Findings as a table on the terminal; ``table`` has the runs that they are from."""
    members = int(table.groupby("case").size().max())
    duration = float(table["duration_s"].iloc[0])
    title = f"The study's claims: {members} run(s) a case, {duration:g} s each"
    header = ("claim", "figure", "found: mean (range)", "holds")
    rows = ((finding.claim, finding.figure, finding.result, finding.verdict) for finding in outcomes)
    print_table(title, header, rows, left=4, lines=True)


def markdown(outcomes: list[Finding]) -> str:
    """Findings as a Markdown table."""
    lines = ["| the study's claim | figure | found: mean (range) | holds |", "|---|---|---|---|"]
    lines += [f"| {f.claim} | {f.figure} | {f.result} | {f.verdict} |" for f in outcomes]
    return "\n".join(lines)
