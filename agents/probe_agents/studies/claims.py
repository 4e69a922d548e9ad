"""Checks the claims of the published study with ensembles of its cases, resumable.

Where the probe vibrates, its motion is chaotic: a claim is tested on statistics of members whose start is perturbed by
0.1 um. Member 0 has the study's start.
"""

import itertools
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.signal import welch
from scipy.stats import mannwhitneyu

from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.records.drawing import BLUE, MM, save
from probe_agents.records.manifest import write_manifest
from probe_agents.records.shipped import file_or_shipped
from probe_agents.records.store import Store, stored_rows, write_tables
from probe_agents.studies.builtin import print_frame
from probe_agents.terminal.tables import print_line
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.arrays import FloatArray
from probe_env.physics.simulation.signals import LOWEST_FREQUENCY, point_statistics

PERTURBATION: Final = 1e-7  # [m]; a float rests a few micrometres deep in its contact spring
DURATION: Final = 8.0  # [s] of the published runs
KEYS: Final = ("case", "member", "duration_s")
USUAL_FEED, USUAL_FRICTION = 0.2, 0.15  # [m/s], Coulomb's coefficient
HIGHEST_FREQUENCY: Final = 100.0  # [Hz]
SPECTRUM_WINDOW, PEAK_REACH = 2.0, 1.0
"""Length of a Hann window [s]; the band on either side of a peak [Hz] is the width of the window's main lobe."""


@dataclass(frozen=True)
class Case:
    """A scene file with changes and a method.

    Attributes:
        settles: statistics over the last third, not after the first quarter.
        carrier_length: [m]; None: the file's.
        feed_speed: magnitude [m/s]; None: the file's.
        withdrawn: feed and air are reversed and the probe starts on the outer wall.
        skips_start: the first quarter is not recorded; the row has the highest peaks of the spectra.
        whole: with the whole model, see ``Scene.whole``.
    """

    name: str
    scene: str
    method: str = "newmark"
    time_step: float = 1e-4
    walls: str = "both"
    settles: bool = False
    carrier_length: float | None = None
    feed_speed: float | None = None
    friction: float = USUAL_FRICTION
    withdrawn: bool = False
    skips_start: bool = False
    whole: bool = False

    @property
    def is_plain(self) -> bool:
        """Whether only method and step differ from the defaults."""
        return self == Case(self.name, self.scene, self.method, self.time_step)

    def load_scene(self) -> Scene:
        """The scene to simulate."""
        base = Scene.from_toml(file_or_shipped("scenes", self.scene))
        sign, couple = (-1.0, "tangent") if self.withdrawn else (1.0, "frame")
        feed = base.feed_speed if self.feed_speed is None else self.feed_speed
        changes = {"feed_speed": sign * feed, "air_supply_rate": sign * base.air_supply_rate, "couple": couple}
        changes |= {"contact": {"walls": self.walls, "friction": self.friction}}
        changes |= {} if self.carrier_length is None else {"carrier_length": self.carrier_length}
        scene = base.model_copy(update=changes)
        return scene.whole() if self.whole else scene


INSERTED: Final = (
    *(Case(f"l{length}", f"fig11_l{length}") for length in (10, 20, 30, 40, 50)),
    Case("l55", "fig12_l55"),
    Case("u0", "fig15_u0", settles=True),
    Case("u100", "fig16_u100"),
    Case("u400", "fig16_u400"),
    Case("dh2500", "fig17_dh2500"),
    Case("q40", "fig18_q40"),
    Case("improved", "fig20_improved"),
    Case("l10-wilson", "fig11_l10", method="wilson"),
    Case("l50-wilson", "fig11_l50", method="wilson"),
    Case("l50-inner", "fig11_l50", walls="inner"),
    Case("l50-dt2e-4", "fig11_l50", time_step=2e-4),
    Case("l50-dt5e-4", "fig11_l50", time_step=5e-4),
    *(Case(f"l{length}-explicit", f"fig11_l{length}", "explicit", 5e-6) for length in (30, 50)),
    *(Case(f"l{length}-implicit", f"fig11_l{length}", "implicit", 2.5e-5) for length in (30, 50)),
)
"""Insertions, as in the study's figures."""
PROBES: Final = {"original": "fig11_l50", "improved": "fig20_improved"}
"""Probes of the study's experiment (e) and their scenes."""


def trip(
    probe: str,
    length: int,
    feed: float = USUAL_FEED,
    friction: float = USUAL_FRICTION,
    method: str = "imex",
    withdrawn: bool = True,
) -> Case:
    """Insertion or withdrawal at constant length [m] and speed [m/s]; the name has the differences from the usual."""
    parts = [probe, f"l{length}", f"u{1e3 * feed:.0f}"]
    parts += [f"mu{1e2 * friction:.0f}"] if friction != USUAL_FRICTION else []
    parts += [method] if method != "imex" else []
    return Case(
        "-".join([*parts, "back" if withdrawn else "in"]), PROBES[probe], method, 1e-4 if method == "newmark" else 2e-4,
        carrier_length=float(length), feed_speed=feed, friction=friction, withdrawn=withdrawn, skips_start=True,
    )  # fmt: skip


def insertion_of(withdrawal: str) -> str:
    """Name of the reference insertion of a withdrawal."""
    return withdrawal.removesuffix("back") + "in"


def _trips() -> Iterator[Case]:
    for probe, withdrawn in product(PROBES, (True, False)):
        lengths = (10, 30, 50, 55) if probe == "original" else (10, 30, 50)  # its guide ends at the helix's end
        weak = (0.2,) if probe == "original" else (0.1, 0.2, 0.4)
        yield from (trip(probe, length, withdrawn=withdrawn) for length in lengths)
        yield from (trip(probe, 50, feed, withdrawn=withdrawn) for feed in (0.1, 0.4))
        yield from (trip(probe, length, method="newmark", withdrawn=withdrawn) for length in (30, 50))
        yield from (trip(probe, 50, feed, 0.25, withdrawn=withdrawn) for feed in weak)


TRIPS: Final = tuple(_trips())
"""Experiment (e): withdrawals, and insertions under the same settings."""
FIRST: Final = ("l10", "l30", "l50", "u0", "improved", "original-l10-u200-back", "original-l10-u200-in")
CASES: Final = tuple(sorted((*INSERTED, *TRIPS), key=lambda case: case.name not in FIRST))
"""All cases, ``FIRST`` first: few of these have a claim each."""
WHOLE: Final = tuple(
    replace(case, method="imex", time_step=2e-4, whole=True)
    for case in CASES
    if (case.method, case.time_step) == (("imex", 2e-4) if case.skips_start else ("newmark", 1e-4))
)
"""The cases that do not compare methods, with the whole model on the study's mesh."""


def run_case(case: Case, member: int, duration: float) -> dict[str, object]:
    """One member of a case as a row: statistics of sensor, tip and root, or the time of divergence."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # some cases are beyond the limit on purpose
        start, perturbation = "outer" if case.withdrawn else "inner", PERTURBATION if member else 0.0
        options = {"perturbation": perturbation, "seed": member, "start": start}
        simulator = Simulator(case.load_scene(), case.method, case.time_step, **options)  # type: ignore[arg-type]
    row: dict[str, object] = {"case": case.name, "member": member, "duration_s": duration, "diverged_at_s": np.nan}
    skipped = round(0.25 * duration, 2) if case.skips_start else 0.0
    try:
        if skipped:
            simulator.advance(duration=skipped)
        run = simulator.advance(duration=duration - skipped, points=("sensor", "tip", "root"))
    except SimulationError as error:
        return row | {"diverged_at_s": error.time}
    since = 0.0 if case.skips_start else duration * (2.0 / 3.0 if case.settles else 0.25)
    row |= point_statistics(run, "sensor", since)
    row["root_tension_mean_n"] = point_statistics(run, "root", since)["tension_mean_n"]
    if not case.skips_start:
        return row | {"tip_radial_max_m": float(run.radial[:, run.column("tip")].max())}  # includes the start
    for name, signal in (("axial", run.axial[:, 0]), ("radial", run.radial[:, 0])):
        row[f"{name}_highest_hz"], row[f"{name}_highest_m"] = highest_peak(signal, run.sample_period)
    return row


def highest_peak(signal: FloatArray, sample_period: float) -> tuple[float, float]:
    """Frequency [Hz] and amplitude of the highest peak between 2 and 100 Hz of a signal (k,) of any unit.

    The amplitude is that of a sine with the power within 1 Hz of the highest value of the Welch spectrum (Hann windows
    of 2 s, half overlapping): A = sqrt(2 P).
    """
    segment = min(len(signal), round(SPECTRUM_WINDOW / sample_period))
    frequency, density = welch(signal, 1.0 / sample_period, nperseg=segment)
    chosen = (frequency >= LOWEST_FREQUENCY) & (frequency <= HIGHEST_FREQUENCY)
    peak = float(frequency[chosen][np.argmax(density[chosen])])
    near = np.abs(frequency - peak) <= PEAK_REACH + 1e-9
    return peak, float(np.sqrt(2.0 * density[near].sum() * frequency[1]))


def run_cases(output: Path, members: int, cases: Sequence[Case] = CASES, jobs: int = 2) -> pd.DataFrame:
    """Run members of cases for ``DURATION``, in ``jobs`` threads; each is stored in ensemble.csv.

    Stored rows of the same duration are not run again.
    """
    store = Store(output / "ensemble.csv", KEYS)
    runs = {(case.name, member, DURATION): (case, member) for member in range(members) for case in cases}
    table = store.fill(runs, lambda run: [run_case(*run, DURATION)], jobs=jobs)
    return _in_order(table[[key in runs for key in table[list(KEYS)].itertuples(index=False, name=None)]])


def load_rows(folder: Path) -> pd.DataFrame:
    """Stored rows of ``DURATION``; empty without a file."""
    path = folder / "ensemble.csv"
    if not path.exists():
        return pd.DataFrame()
    table = stored_rows(path)
    return _in_order(table[table["duration_s"] == DURATION])


def _in_order(table: pd.DataFrame) -> pd.DataFrame:
    return table.sort_values(["case", "member"]).reset_index(drop=True)


SIGNIFICANCE: Final = 0.05
YES, NO, UNCLEAR = "yes", "no", "not clearly"
RADIAL, ACCELERATION = "radial_rms_m", "radial_acceleration_rms_m_per_s2"
GROWTH: Final = (10, 20, 30, 40, 50, 55)
"""[m] carrier lengths of the study's figure 11 and 12."""
NOTICEABLE: Final = 0.1
"""Share of the insertion's highest peak from which a peak of the withdrawal is noticeable: -20 dB."""
MIN_PEAK: Final = 1e-6
"""Minimum amplitude of a noticeable peak [m]: a hundredth of the vibration limit."""
TUBE_BORE: Final = 24.2e-3  # [m]
ABOUT: Final = 0.1
"""Relative deviation that "about" allows: the study gives a frequency of two digits."""

Test = Callable[[FloatArray, FloatArray], str]


def run(
    output: Path, limit: int | None = None, trials: int = 1, assumptions: str = "study", workers: Workers = HERE
) -> pd.DataFrame:
    """Run the cases that are not stored; writes ensemble.csv, claims.csv (``claims_of``) and growth.png.

    ``trials`` is the number of runs of a case, ``limit`` the number of cases, the most telling first; default: all.
    """
    duration, cases = DURATION, WHOLE if assumptions == "whole" else CASES
    table = run_cases(output, trials, cases[:limit], workers.jobs)
    claims = claims_of(table)
    files = write_tables(output, {"claims": claims}, 4)
    write_manifest(output, ("ensemble.csv", *files), commits=table["commit"], members=trials, duration_s=duration)
    columns = ("claim", "figure", "case", "statistic", "mean", "least", "greatest", "reference_mean", "holds")
    print_frame(f"Claims: {trials} run(s) per case, {duration:g} s each", claims, columns, texts=4)
    complete = Ensemble(table).has(*(f"l{length}" for length in GROWTH))
    if complete:
        draw_growth(table, output / "growth.png")
    print_line(f"written: {output}/ (ensemble.csv, claims.csv{', growth.png' if complete else ''})")
    return claims


class Ensemble:
    """Members of an ensemble table by case and statistic; ``diverged`` is 0 or 1."""

    def __init__(self, table: pd.DataFrame) -> None:
        self.table = table.assign(diverged=table["diverged_at_s"].notna())

    def has(self, *cases: str) -> bool:
        """Whether every case has at least one member."""
        return set(cases) <= set(self.table["case"])

    def values(self, case: str, statistic: str) -> FloatArray:
        """One statistic of all members of a case, diverged ones as NaN."""
        values: FloatArray = self.table.loc[self.table["case"] == case, statistic].to_numpy(dtype=float)
        return values

    def mean(self, case: str, statistic: str = RADIAL) -> float:
        """Mean over the members."""
        return float(np.mean(self.values(case, statistic)))


def greater(a: FloatArray, b: FloatArray) -> bool:
    """Whether ``a`` is greater than ``b``: one-sided Mann-Whitney test, or means with fewer than four values."""
    if min(len(a), len(b)) < 4:
        return bool(a.mean() > b.mean())
    return bool(mannwhitneyu(a, b, alternative="greater").pvalue < SIGNIFICANCE)


def less(a: FloatArray, b: FloatArray, opposite: str = NO) -> str:
    """Whether ``a`` is less than ``b``; no if a member of either diverged."""
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return NO
    return YES if greater(b, a) else opposite if greater(a, b) else UNCLEAR


def _more(a: FloatArray, b: FloatArray) -> str:
    return less(b, a)


def _if(condition: Callable[[FloatArray, FloatArray], bool]) -> Test:
    return lambda a, b: YES if condition(a, b) else NO


class Claim(NamedTuple):
    """One row of the table: statistic of a case, reference (another case or a number) and test."""

    claim: str
    figure: str
    case: str
    reference: str | float
    statistic: str
    test: Test


def _sharpest(e: Ensemble, statistic: str = RADIAL) -> Test:
    """On the linear axes of figure 11: the rise from 30 to 40 m is more than that before and not less than the next."""
    before, start, end, after = (e.values(f"l{length}", statistic) for length in (20, 30, 40, 50))
    return lambda *_: "later" if greater(after + start, 2.0 * end) else less(2.0 * start, before + end, "earlier")


def _one_peak(e: Ensemble) -> Test:
    common, axial = (float(np.median(e.values("l55", f"{name}_peak_hz"))) for name in ("common", "axial"))
    return lambda *_: YES if abs(common - 14.0) <= 2.0 and abs(axial - common) <= 1.0 else NO


def _insertion(e: Ensemble) -> Iterator[Claim]:
    """The claims about insertion."""
    for short, long in ((10, 30), (20, 40), (30, 50)):
        yield Claim("vibration grows with length", "11", f"l{long}", f"l{short}", RADIAL, _more)
    if e.has(*(f"l{length}" for length in GROWTH)):
        yield Claim("it rises sharply between 30 and 40 m", "11", "l40", "l30", RADIAL, _sharpest(e))
    yield Claim("no vibration without feed", "15", "u0", "l50", RADIAL, _if(lambda a, b: a.max() <= 0.01 * b.mean()))
    yield Claim("less at 0.1 m/s", "16", "u100", "l50", RADIAL, less)
    yield Claim("more at 0.4 m/s", "16", "u400", "l50", RADIAL, _more)
    yield Claim("less in a helix of 2.5 m", "17", "dh2500", "l50", RADIAL, less)
    displacement = partial(less, opposite=UNCLEAR)
    yield Claim("less at 40 m3/h: displacement", "18", "q40", "l50", RADIAL, displacement)
    yield Claim("less at 40 m3/h: acceleration, as measured in the experiment", "18", "q40", "l50", ACCELERATION, less)
    if e.has("l55"):
        for statistic in ("common_peak_hz", "axial_peak_hz"):
            yield Claim("one axial and radial peak at 14 Hz, l = 55 m", "14", "l55", 14.0, statistic, _one_peak(e))
    fifth, more = _if(lambda a, b: b.mean() >= 5.0 * a.mean()), _if(lambda a, b: b.mean() >= a.mean())
    yield Claim("the improved probe is nearly silent, l = 50 m", "20", "improved", "l50", RADIAL, fifth)
    near = _if(lambda a, b: abs(a.mean() / b.mean() - 1.0) <= 0.01)
    yield Claim("Wilson and Newmark agree", "-", "l10-wilson", "l10", "axial_mean_m", near)
    same = _if(lambda a, b: not (greater(a, b) or greater(b, a)))
    yield Claim("Wilson and Newmark agree", "-", "l50-wilson", "l50", RADIAL, same)
    for case in ("l50-dt2e-4", "l50-dt5e-4"):
        yield Claim("diverges above a step of 1e-4 s", "-", case, "l50", "diverged", _if(lambda a, _: bool(a.all())))
    yield Claim("only the inner wall is touched", "5", "l50-inner", TUBE_BORE, "tip_radial_max_m", more)


def _experiment(e: Ensemble) -> Iterator[Claim]:
    """What the study's experiment measured by acceleration, (c) and (f); the rest of it is in the other claims."""
    about = _if(lambda a, b: bool(abs(a.mean() / b.mean() - 1.0) <= ABOUT))
    for length in (30, 55):
        yield Claim("a peak at about 20 Hz", "(c)", f"l{length}", 20.0, "axial_peak_hz", about)
    if e.has(*(f"l{length}" for length in GROWTH)):
        sharpest = _sharpest(e, ACCELERATION)
        yield Claim("it rises sharply after the middle of the helix", "(c)", "l40", "l30", ACCELERATION, sharpest)
    for claim, case in (("less at 0.1 m/s", "u100"), ("less in a helix of 2.5 m", "dh2500")):
        yield Claim(claim, "(f)", case, "l50", ACCELERATION, less)


def _return(e: Ensemble) -> Iterator[Claim]:
    """The claims about withdrawal (the study's experiment e), compared with insertion under the same settings."""
    withdrawals = [case for case in TRIPS if case.withdrawn and e.has(case.name, insertion_of(case.name))]
    for case in withdrawals:
        yield Claim("less vibration in the return", "(e)", case.name, insertion_of(case.name), RADIAL, less)
    usual = [case for case in withdrawals if case.friction == USUAL_FRICTION]
    for probe, direction in itertools.product(PROBES, ("radial", "axial")):
        chosen = [case.name for case in usual if case.scene == PROBES[probe]]
        if chosen:
            statistic = f"{direction}_highest_m"
            highest = max(chosen, key=lambda name, key=statistic: e.mean(name, key))  # type: ignore[misc]
            claim = f"no noticeable {direction} peak in the return from 2 s on: {probe}"
            test = _not_noticeable(e, chosen, statistic)
            yield Claim(claim, "(e)", highest, insertion_of(highest), statistic, test)
    for withdrawn, direction in ((False, "insertion"), (True, "return")):
        old, new = (trip(probe, 50, withdrawn=withdrawn).name for probe in PROBES)
        claim = f"the improved probe vibrates less in the {direction}: 50 m, 0.2 m/s"
        yield Claim(claim, "(e)", new, old, RADIAL, less)


def _not_noticeable(e: Ensemble, withdrawals: list[str], statistic: str) -> Test:
    peaks = np.array([e.mean(name, statistic) for name in withdrawals])
    fractions = peaks / [e.mean(insertion_of(name), statistic) for name in withdrawals]
    noticeable = ((fractions >= NOTICEABLE) & (peaks >= MIN_PEAK)).any()
    return lambda *_: UNCLEAR if noticeable else YES


def claims_of(table: pd.DataFrame) -> pd.DataFrame:
    """Every claim whose cases are in an ensemble table.

    Columns claim, figure, statistic, case, mean, least, greatest (of its members), reference, reference_mean, ratio
    and holds ("yes", "no", "not clearly", "earlier" or "later").
    """
    e = Ensemble(table)
    rows = []
    for claim in (*_insertion(e), *_experiment(e), *_return(e)):
        cases = [case for case in (claim.case, claim.reference) if isinstance(case, str)]
        if e.has(*cases):
            values = e.values(claim.case, claim.statistic)
            number = isinstance(claim.reference, float)
            reference = np.array([claim.reference]) if number else e.values(str(claim.reference), claim.statistic)
            base = float(reference.mean())
            row = claim._asdict() | {"mean": values.mean(), "least": values.min(), "greatest": values.max()}
            row |= {"reference": "-" if number else claim.reference, "reference_mean": base}
            row |= {"ratio": values.mean() / base if base else float("nan"), "holds": claim.test(values, reference)}
            rows.append(row)
    columns = ["claim", "figure", "statistic", "case", "mean", "least", "greatest"]
    return pd.DataFrame(rows, columns=[*columns, "reference", "reference_mean", "ratio", "holds"])


def draw_growth(table: pd.DataFrame, path: Path) -> None:
    """Radial rms at the sensor over the carrier length: range and mean of the ensemble."""
    members = [Ensemble(table).values(f"l{length}", RADIAL) * MM for length in GROWTH]
    figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
    low, high = ([f(values) for values in members] for f in (min, max))
    axis.fill_between(GROWTH, low, high, color=BLUE, alpha=0.2, label="range of the perturbed runs")
    axis.plot(GROWTH, [values.mean() for values in members], "o-", color=BLUE, label="mean")
    axis.set(xlabel="carrier length [m]", ylabel="radial rms at the sensor [mm]", yscale="log")
    axis.legend(frameon=False)
    save(figure, path)
