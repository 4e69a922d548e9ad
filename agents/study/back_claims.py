"""The study's experiment (e), the return beside the insertion, judged on an ensemble table."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from agents.study.back import BACKS, PROBES, SETTLED, SETTLING, TANGENTS, Trip
from agents.study.cases import DURATION
from agents.study.claims import Ensemble, Finding, short
from probe_env.physics.closed_forms import steady_root_tension

NOTICEABLE: Final = 0.1
"""Share of the insertion's highest peak from which one of the return is noticeable: a tenth, -20 dB."""
LEAST_PEAK: Final = 1e-6
"""Amplitude [m] from which a peak is noticeable at all: a hundredth of the vibration limit."""
BEGIN: Final = 0.25 * DURATION
"""Of the statistics of a published run [s]."""
TENSION_TOLERANCE: Final = 0.01
USUAL_FEED: Final = Trip.feed  # [m/s]; above it the centrifugal force, which the closed form leaves out, counts
FIGURE: Final = "(e)"


def back_findings(table: pd.DataFrame, scenes: Path = Path("configs/scenes")) -> list[Finding]:
    """Every claim on the return that the cases in the table can answer; ``scenes`` holds the scene files."""
    e = Ensemble(table)
    paired = [trip for trip in (*BACKS, *SETTLED) if e.has(trip.name, _fed(trip))]
    return [
        *(_less_vibration(e, trip) for trip in paired),
        *_peaks(e, paired),
        *_improvement(e, paired),
        *_tensions(e, paired, scenes),
        *_couple(e),
    ]


def described(trip: Trip) -> str:
    """Probe, length, feed, and what differs from the usual."""
    words = [f"{trip.probe}, {trip.carrier_length} m, {trip.feed:g} m/s"]
    words += [f"friction {trip.friction:g}"] if trip.friction != Trip.friction else []
    words += [trip.method] if trip.method != Trip.method else []
    words += [f"{trip.settling:g} s later"] if trip.settling else []
    return ", ".join(words)


def _less_vibration(e: Ensemble, trip: Trip) -> Finding:
    back, fed = trip.name, _fed(trip)
    diverged = [int(np.isfinite(e.values(name, "diverged_at_s")).sum()) for name in (back, fed)]
    claim = f"less vibration in the return: {described(trip)}"
    if any(diverged):
        return Finding(claim, FIGURE, f"{diverged[0]} runs back and {diverged[1]} in diverged", "no")
    less = e.mean(back) / e.mean(fed)
    axial = e.mean(back, "axial_rms_m") / e.mean(fed, "axial_rms_m")
    result = f"radial rms {e.mm(back)} against {e.mm(fed)} mm: {short(less)} times; axial {short(axial)} times"
    return Finding(claim, FIGURE, result, _verdict(e, fed, back))


def _fed(trip: Trip) -> str:
    """The insertion that a return is judged against; it needs no settling."""
    return replace(trip, settling=0.0).beside().name


def _verdict(e: Ensemble, large: str, small: str) -> str:
    """Whether the radial rms of one case is less than that of another."""
    return "yes" if e.greater(large, small) else "no" if e.greater(small, large) else "not clearly"


def _peaks(e: Ensemble, paired: list[Trip]) -> Iterator[Finding]:
    """The highest peak of the return's spectrum beside the insertion's, over the settings of a probe."""
    for probe, direction in itertools.product(PROBES, ("radial", "axial")):
        key = f"{direction}_highest_m"
        for settling in (0.0, SETTLING):
            usual = probe, Trip.friction, settling
            chosen = [trip for trip in paired if (trip.probe, trip.friction, trip.settling) == usual]
            if chosen:
                peaks = np.array([e.mean(trip.name, key) for trip in chosen])
                shares = peaks / [e.mean(_fed(trip), key) for trip in chosen]
                most = int(np.argmax(peaks))
                hertz = np.median(e.values(chosen[most].name, f"{direction}_highest_hz"))
                result = (
                    f"{len(chosen)} setting(s), the highest {e.mm(chosen[most].name, key)} against"
                    f" {e.mm(_fed(chosen[most]), key)} mm, {hertz:.1f} Hz, {described(chosen[most])};"
                    f" at most {short(shares.max())} times the insertion's"
                )
                noticed = ((shares >= NOTICEABLE) & (peaks >= LEAST_PEAK)).any()
                claim = f"no noticeable {direction} peak in the return from {BEGIN + settling:g} s on: {probe}"
                yield Finding(claim, FIGURE, result, "not clearly" if noticed else "yes")


def _improvement(e: Ensemble, paired: list[Trip]) -> Iterator[Finding]:
    """Conclusion (e): the improved probe against the original one, both ways."""
    for old in (Trip("original", "back", 50), Trip("original", "back", 50, settling=SETTLING)):
        new = replace(old, probe="improved")
        if old in paired and new in paired:
            ways = [] if old.settling else [("insertion", _fed(old), _fed(new))]
            for way, large, small in (*ways, ("return", old.name, new.name)):
                result = f"radial rms {e.mm(small)} against {e.mm(large)} mm"
                later = f" {SETTLING:g} s later" if old.settling else ""
                claim = f"the improved probe vibrates less in the {way}{later}: 50 m, 0.2 m/s"
                yield Finding(claim, FIGURE, result, _verdict(e, large, small))


def _tensions(e: Ensemble, paired: list[Trip], scenes: Path) -> Iterator[Finding]:
    """Steady sliding under pressure: the capstan on the outer wall, where the start does not ring."""
    for probe in PROBES:
        steady = [trip for trip in paired if trip.probe == probe and (trip.friction == Trip.friction or trip.settling)]
        if steady:
            slow = _tension_error(e, [trip for trip in steady if trip.feed <= USUAL_FEED])
            fast = _tension_error(e, [trip for trip in steady if trip.feed > USUAL_FEED])
            shown = [trip for trip in steady if trip == Trip(probe, "back", trip.carrier_length)]
            roots = "; ".join(
                f"{trip.carrier_length} m {e.mean(trip.name, 'root_tension_mean_n'):.2f}"
                f" against {steady_root_tension(trip.scene(scenes)):.2f} N"
                for trip in shown
            )
            result = (
                f"along the probe within {1e2 * slow:.2g} % of the root's up to {USUAL_FEED:g} m/s,"
                f" {1e2 * fast:.2g} % above; root force {roots}"
            )
            claim = f"(ours) pressure along the probe is that of steady sliding: {probe}, {len(steady)} settings"
            holds = f"up to {USUAL_FEED:g} m/s" if fast > TENSION_TOLERANCE else "yes"
            yield Finding(claim, "-", result, holds if slow <= TENSION_TOLERANCE else "no")


def _tension_error(e: Ensemble, trips: list[Trip]) -> float:
    """Greatest difference from the closed form over all members, as a share of the root's force."""
    return max((float(e.values(trip.name, "tension_error").max()) for trip in trips), default=0.0)


def _couple(e: Ensemble) -> Iterator[Finding]:
    for trip in TANGENTS:
        frame = replace(trip, couple=None).name
        if e.has(trip.name, frame):
            apart = e.greater(trip.name, frame) or e.greater(frame, trip.name)
            result = f"radial rms {e.mm(trip.name)} against {e.mm(frame)} mm"
            claim = f"(ours) the couple counted from the tangent changes the insertion: {described(trip)}"
            yield Finding(claim, "-", result, "yes" if apart else "not clearly")
