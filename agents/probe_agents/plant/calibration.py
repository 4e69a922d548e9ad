"""Calibration of a plant from its logs: ``calibration.json``, tables, figures and a check of the fit."""

import json
import logging
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from probe_agents.plant.inference import (
    LIMIT,
    Z90,
    Gain,
    Likelihood,
    LogCase,
    Posterior,
    Sliding,
    fit_gain,
    fit_sliding,
    sample_posterior,
)
from probe_agents.plant.logs import DETECTED, read_log
from probe_agents.plant.prior import UNKNOWNS, Prior, prior_of
from probe_agents.plant.response import CHANNELS, Response, metres_of
from probe_agents.records.cells import ReadOptions
from probe_agents.records.quantities import HOUR, IGNORED
from probe_agents.records.shipped import file_or_shipped
from probe_agents.terminal.names import name_of, name_problem
from probe_agents.terminal.tables import print_table, print_terms
from probe_env import Plant
from probe_env.arrays import FloatArray
from probe_env.files import FileError
from probe_env.physics.model.chain import air_speed
from probe_env.settings import within

LEVEL: Final = 0.90
"""Probability of the intervals."""
LABELS: Final = (
    ("root tension [N]", 1.0),
    ("radial acceleration rms [m/s²]", 1.0),
    ("axial acceleration rms [m/s²]", 1.0),
    ("radial rms by the noise [mm]", 1e3),
)
"""Label of each channel in a picture, and its scale."""
POSTERIOR: Final = re.compile(r"^posterior *=.*\n+", re.MULTILINE)
"""Line of a tube file with its calibration."""
SIMPLER: Final = 0.8
"""Scatter of the tension about the study's closed form over that about the whole model's: below it a log is of the
study's model. It is 0.06 to 0.61 for eight such logs, and above 7 for 16 of the whole model (measured once)."""
QUESTION: Final = "are its scale, zero and unit right, and bore, floats and air those of the tube file?"
"""What to ask first where a channel deviates from the model."""
SLOW: Final = 0.9
"""Fraction of the task's least feed up to which rows of a log are left out; the rest allows for the encoder's noise."""
BAND_DRAWS: Final = 64
"""Draws in a picture of bands."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration."""

    prior: Prior
    posterior: Posterior
    sliding: dict[str, Sliding | None]  # tube -> estimate from the tension alone; None without a tension
    outside: list[str]  # quantities of the logs outside the training ranges of the response, as texts
    gains: list[Gain | None]  # of the tension gauge, per log; None without a tension
    simpler: list[str]  # tubes whose tension is that of the study's model

    @property
    def cases(self) -> Sequence[LogCase]:
        """The logs."""
        return self.posterior.likelihood.cases

    def summary(self, name: str, tube: int | None = None) -> dict[str, float]:
        """Mean and 90 % interval of an unknown, of one tube or over all tubes."""
        column = list(UNKNOWNS).index(name)
        draws = self.posterior.draws[:, :, column] if tube is None else self.posterior.draws[tube, :, column]
        low, high = np.quantile(draws, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
        return {"mean": float(draws.mean()), "low": float(low), "high": float(high)}

    def bands(self, number: int) -> FloatArray:
        """(3, m, c) 5th, 50th and 95th percentile that is expected of the channels of a log [SI]."""
        likelihood, rng = self.posterior.likelihood, np.random.default_rng(number)
        draws = self.posterior.draws[likelihood.tube_indices[number]]
        table = draws[rng.choice(len(draws), min(BAND_DRAWS, len(draws)), replace=False)]
        deviations, spread = likelihood.deviations(number, table)
        mean = likelihood.observed[number] - deviations * spread
        sample = 10.0 ** (mean + spread * rng.normal(size=mean.shape))
        return np.asarray(np.quantile(sample, [(1.0 - LEVEL) / 2.0, 0.5, (1.0 + LEVEL) / 2.0], axis=0))

    @property
    def misfits(self) -> list[str]:
        """Reasons why the model cannot have produced these logs, as texts; empty if it can."""
        reasons, limits = [], self.posterior.likelihood.response.misfit
        reasons += [
            f"{tube}: the root tension is that of a weightless cable in air that does not expand, as in the study's"
            " model (assumptions = 'study'): simulated logs need assumptions = 'whole'"
            for tube in self.simpler
        ]
        for case, misfit, gauge in zip(self.cases, self.posterior.misfit, self.gains, strict=True):
            reasons += [f"{case.name}: the column {fault}" for fault in case.faults]
            wrong = [k for k in range(len(CHANNELS)) if misfit[k] > limits[k]]
            scaled = gauge is not None and gauge.ratio > LIMIT and not case.faults
            cures, cure = [0] if scaled else wrong, ""
            if len(cures) == 1 < len(case.metres.measured):
                head = case.heads.get(CHANNELS[cures[0]], CHANNELS[cures[0]])
                cure = f" If not, or if you cannot tell, calibrate without it: --columns '{head}={IGNORED}'."
            if gauge and scaled:
                reasons.append(
                    f"{case.name}: the load cell seems to read {abs(gauge.gain - 1.0):.0%} too"
                    f" {'high' if gauge.gain > 1.0 else 'low'}: {QUESTION}{cure}"
                    f" (2 log likelihood ratio {gauge.ratio:.1f}, limit {LIMIT:g})"
                )
            for k in wrong or [len(CHANNELS)]:
                if misfit[k] > limits[k] and not (k == 0 and scaled):
                    name = (*CHANNELS, "measurements together")[k].replace("_", " ")
                    reasons.append(
                        f"{case.name}: the {name} cannot be of this tube: {QUESTION}{cure}"
                        f" ({np.sqrt(misfit[k]):.1f} standard deviations (rms) from the model; 99 % of simulated logs"
                        f" are below {np.sqrt(limits[k]):.1f})"
                    )
        return reasons

    @property
    def at_bounds(self) -> list[str]:
        """Unknowns with more than half of their posterior in 6 % of the range next to a bound, as texts."""
        texts = []
        for column, name in enumerate(UNKNOWNS):
            if name in self.prior.fixed:
                continue
            low, high = self.prior.ranges[name]
            at = (self.posterior.draws[:, :, column] - low) / (high - low)
            for side, near in (("lower", at < 0.06), ("upper", at > 0.94)):
                if near.mean() > 0.5:
                    cure = "check bore, floats, air and gauges, or widen its range in the tube file"
                    texts.append(f"{UNKNOWNS[name].text} is at its {side} bound: {cure}")
        return texts

    @property
    def verdict(self) -> str:
        """Whether the model fits the logs."""
        if self.misfits:
            return "misspecified: the model does not fit these logs at any friction - do not use these estimates"
        if self.at_bounds:
            return "doubtful: an estimate is at the bound of its range"
        return "model and log agree"

    def to_json(self) -> dict[str, Any]:
        """``calibration.json``: estimates, draws, verdict."""
        draws = self.posterior.draws
        rows = np.arange(draws.shape[1])
        turns = rows % len(draws)  # over all tubes: draws of each in turn
        return {
            **{name: self.summary(name) | {"unit": UNKNOWNS[name].unit} for name in UNKNOWNS},
            "verdict": self.verdict,
            "misspecified": bool(self.misfits),
            "reasons": [*self.misfits, *self.at_bounds, *self.outside],
            "tubes": {
                tube: {
                    "friction": self.summary("friction", k),
                    "logs": [case.name for case in self.cases if case.tube == tube],
                    "helix_diameter": next(c.scene.tube.helix_diameter for c in self.cases if c.tube == tube),
                    "by_tension_alone": fit
                    and {
                        name: dict(zip(("mean", "low", "high"), getattr(fit, name), strict=True))
                        for name in ("friction", "drag_coefficient")
                    },
                }
                for k, (tube, fit) in enumerate(self.sliding.items())
            },
            "held_possible": {name: list(range_) for name, range_ in self.prior.ranges.items()},
            "known": self.prior.fixed,
            "draws": {
                name: [float(f"{v:.6g}") for v in draws[turns, rows, column]]
                for column, name in enumerate(UNKNOWNS)
                if name not in self.prior.fixed
            },
        }


def read_cases(
    paths: Sequence[Path],
    plant: Plant,
    helix_diameters: Sequence[float],
    tubes: Sequence[str],
    options: ReadOptions = DETECTED,
) -> list[LogCase]:
    """Read the logs and assign their tubes; all arguments are checked before the first log is read.

    Args:
        paths: log files.
        plant: scene, and the diameters of its helices.
        helix_diameters: [m], one for all logs, one each, or none for those of the plant.
        tubes: name of the tube of each log; logs of one tube share its friction. Empty: one tube a diameter.
        options: what the files do not say themselves.
    """
    if not paths:
        raise ValueError("logs: at least one is needed")
    if options.passage == "out":
        raise ValueError("pass = 'out': calibration is of insertions, in which friction has another sign")
    diameters = list(helix_diameters) or list(plant.diameters)
    if len(diameters) == 1:
        diameters *= len(paths)
    if len(diameters) != len(paths):
        what = "--helix-diameters" if helix_diameters else "tube.helix_diameter"
        hint = "give --helix-diameters, one for all or one each [m]"
        raise ValueError(f"{what}: {len(diameters)} for {len(paths)} logs: {hint}")
    for diameter in diameters:
        within("helix_diameter", diameter, 0.3, 1e4, "m")
        if len(plant.diameters) > 1 and not any(abs(diameter - other) < 1e-6 for other in plant.diameters):
            listed = ", ".join(f"{other:g}" for other in plant.diameters)
            raise ValueError(f"--helix-diameters: {diameter:g} m is none of the plant's: {listed} m")
    names = list(tubes) or [f"{diameter:g} m" for diameter in diameters]
    if len(names) != len(paths):
        raise ValueError(f"--tubes: {len(names)} names for {len(paths)} logs: give one for each log")
    for name in names:
        if problem := name_problem(name):
            raise ValueError(f"--tubes: {name[:100]!r} {problem}")
        distinct = sorted({diameter for diameter, other in zip(diameters, names, strict=True) if other == name})
        if len(distinct) > 1:
            listed = " and ".join(f"{d:g}" for d in distinct)
            raise ValueError(f"--tubes: {name!r} has helix diameters of {listed} m: a tube has one")
    files = [file_or_shipped("logs", path) for path in paths]
    labels = [name_of(file) for file in files]
    labels = labels if len(set(labels)) == len(labels) else [str(path) for path in paths]
    cases = []
    for label, file, tube, diameter in zip(labels, files, names, diameters, strict=True):
        scene = plant.scene.model_copy(update={"tube": {"helix_diameter": diameter}})
        log, min_feed = read_log(file, options), plant.config.feed_speeds[0]
        if fatal := next((fault.text for fault in log.faults if fault.fatal), ""):
            raise FileError(file, f"column {fatal}")
        metres, notes = metres_of(log, SLOW * min_feed), [*log.notes]
        slow = (log.feed_speed > 0.0) & (log.feed_speed <= SLOW * min_feed)
        if slow.any():
            seconds, length = np.diff(log.time, append=log.time[-1])[slow].sum(), log.inserted_length[slow]
            notes.append(
                f"Left out: {seconds:.3g} s between {length.min():.4g} and {length.max():.4g} m with a feed below"
                f" {min_feed:g} m/s, the task's least, at which friction is not modelled well."
            )
        minimum = metres.feed / air_speed(scene, 1.0)
        if (slow := metres.air <= minimum).any():
            k = int(slow.argmax())
            problem = f"air_supply = {HOUR * metres.air[k]:.4g} m3/h at an inserted length of {metres.length[k]:g} m"
            hint = f"calibration needs air that is faster than the feed, there more than {HOUR * minimum[k]:.3g} m3/h"
            raise FileError(file, f"{problem}: {hint} - is the column or its unit wrong?")
        faults = tuple(
            f"{fault.text}: leave it out, --columns '{log.heads[fault.channel]}={IGNORED}'" for fault in log.faults
        )
        cases.append(LogCase(label, tube, scene, metres, faults, tuple(notes), log.heads))
    return cases


def calibrate(
    cases: Sequence[LogCase], plant: Plant, response: Response, file: str = "tube", progress: bool = True
) -> Calibration:
    """Estimate the friction of each tube, and the stiffness, drag and damping that all tubes share.

    Args:
        cases: logs, see ``read_cases``.
        plant: its known values are fixed; its distributions are priors.
        response: see ``stored_response``.
        file: name of the plant in errors.
        progress: show a progress bar.

    Raises:
        ValueError: a log has too few metres or no channel, or a value of the plant is outside the training ranges.
    """
    prior = prior_of(plant, file)
    posterior = sample_posterior(response, cases, prior, progress=progress)
    outside = [f"{c.name}: {text}" for c in cases for text in response.outside(c.metres, c.scene)]
    sliding = {tube: fit_sliding([c for c in cases if c.tube == tube], prior) for tube in posterior.likelihood.tubes}
    gains = [fit_gain(posterior.likelihood, number, prior) for number in range(len(cases))]
    simpler = []
    for tube, whole in sliding.items():
        study = fit_sliding(
            [c._replace(scene=c.scene.study()) for c in cases if c.tube == tube and not c.faults], prior
        )
        if whole and study and study.scatter < SIMPLER * whole.scatter:
            simpler.append(tube)
    return Calibration(prior, posterior, sliding, outside, gains, simpler)


def check_log(calibration: Calibration, case: LogCase) -> Calibration:
    """Predict a log of one of the tubes, which is not fitted; its misfit is that at the draw that explains it best."""
    draws = calibration.posterior.draws[[list(calibration.sliding).index(case.tube)]]
    likelihood = Likelihood(calibration.posterior.likelihood.response, [case])
    misfits = np.array([likelihood.misfit(0, draw) for draw in draws[0, :: draws.shape[1] // BAND_DRAWS]])
    posterior = Posterior(draws, [misfits[misfits[:, -1].argmin()]], likelihood)
    return replace(calibration, posterior=posterior, sliding={case.tube: None}, outside=[], gains=[None], simpler=[])


def print_check(checked: Calibration) -> dict[str, Any]:
    """Print and return the verdict on a log of ``check_log``, and its channels relative to what is predicted."""
    case, chosen = checked.cases[0], checked.posterior.likelihood.chosen[0]
    ratios = 10.0 ** (checked.posterior.likelihood.observed[0] - np.log10(checked.bands(0)[1])).mean(axis=0)
    rows = [(CHANNELS[k].replace("_", " "), f"{ratio:.3g}") for k, ratio in zip(chosen, ratios, strict=True)]
    verdict = f"the calibration {'does not predict' if checked.misfits else 'predicts'} {case.name}"
    print_table(f"Check by {case.name}", ("", "measured / predicted"), rows, left=1)
    print_terms({"verdict": verdict})
    for text in (*checked.misfits, *case.notes):
        print_terms({"note": text})
    return {"log": case.name, "verdict": verdict, "reasons": checked.misfits}


def tube_file(target: Path, posterior: Path, tube: Path | None) -> str:
    """Text of a tube file that names a calibration, above the tables of ``tube`` or the instrument of the example.

    Args:
        target: the file to write.
        posterior: ``calibration.json``.
        tube: file or name of the plant; None: the study's, with instrument, task and bundle of the example.
    """
    if target.suffix != ".toml":
        raise FileError(target, "a tube file must end with .toml")
    example = file_or_shipped("tubes", Path("example")) if tube is None else None
    text = (example or file_or_shipped("tubes", Path(str(tube)))).read_text(encoding="utf-8")
    tables = text[text.index("[instrument]") :] if example else POSTERIOR.sub("", text, count=1)
    if target.exists() and POSTERIOR.sub("", target.read_text(encoding="utf-8"), count=1).strip() != tables.strip():
        raise FileError(target, "exists and has other tables: choose another name, or give it as --tube")
    path = os.path.relpath(posterior.resolve(), target.resolve().parent)
    return f"posterior = {json.dumps(path, ensure_ascii=False)}\n{tables}"


def print_calibration(calibration: Calibration, with_file: bool = True) -> None:
    """Print estimates, intervals and the verdict; ``with_file``: whether a file describes the tubes."""
    prior = calibration.prior
    estimates: list[tuple[str, Sequence[float], str]] = []
    for k, (tube, sliding) in enumerate(calibration.sliding.items()):
        where = f" in {tube}" if len(calibration.sliding) > 1 else ""
        estimates.append((f"friction{where}", [*calibration.summary("friction", k).values()], ""))
        if sliding:
            estimates.append((f"friction{where} by the tension alone", sliding.friction, ""))
    for name, unknown in UNKNOWNS.items():
        if name in prior.quantile and name != "friction":
            estimates.append((unknown.text, [*calibration.summary(name).values()], unknown.unit))
    for case, drag in zip(calibration.cases, calibration.posterior.likelihood.drags, strict=True):
        if drag:
            mean, factor = drag[0], np.exp(Z90 * drag[1])
            estimates.append(
                (f"drag coefficient by the pressure of {case.name}", (mean, mean / factor, mean * factor), "")
            )
    rows = [(text, *(f"{value:.4g}" for value in values), unit) for text, values, unit in estimates]
    print_table("Estimates: means with 90 % intervals", ("", "mean", "low", "high", "unit"), rows, left=1)
    logs = (
        f"{case.name}: {len(case.metres)} metres, {', '.join(name.replace('_', ' ') for name in case.metres.measured)}"
        for case in calibration.cases
    )
    geometry = dict.fromkeys(
        f"bore {1e3 * case.scene.tube.inner_diameter:g} mm, helix of {case.scene.tube.helix_diameter:g} m, floats of"
        f" {1e3 * case.scene.probe.carrier_float_diameter:g} mm"
        for case in calibration.cases
    )
    terms = {"logs": "; ".join(logs), "geometry": "; ".join(geometry)}
    if not with_file:
        terms["geometry"] += ". This is table 2 of the study: give yours by --tube, since friction depends on it"
    if prior.assumed:
        terms["assumed"] = "not in the tube file: " + "; ".join(prior.assumed)
    if prior.fixed:
        fixed = (f"{UNKNOWNS[name].text} {value:g} {UNKNOWNS[name].unit}" for name, value in prior.fixed.items())
        terms["fixed"] = "in the tube file: " + "; ".join(text.strip() for text in fixed)
    outside = (f"outside the training range of the response: {text}" for text in calibration.outside)
    print_terms({"verdict": calibration.verdict})
    notes = (f"{case.name}: {text}" for case in calibration.cases for text in case.notes)
    for text in (*calibration.misfits, *calibration.at_bounds, *outside, *notes):
        print_terms({"note": text})
    print_terms(terms)


def draw_corner(calibration: Calibration, path: Path) -> Path:
    """Draw a corner plot of the friction of every tube and the shared unknowns."""
    import corner

    from probe_agents.records.drawing import BLUE, escape_dollars, save

    draws, columns, labels = calibration.posterior.draws, [], []
    for column, name in enumerate(UNKNOWNS):
        if name in calibration.prior.fixed:
            continue
        several = name == "friction" and len(draws) > 1
        for k, tube in enumerate(calibration.sliding if several else ("",)):
            columns.append(draws[k, :, column])
            unit = f" [{UNKNOWNS[name].unit}]" if UNKNOWNS[name].unit else ""
            labels.append(UNKNOWNS[name].text + (f"\n{escape_dollars(tube)}" if several else "") + unit)
    before, small = logging.root.manager.disable, {"fontsize": 9}
    logging.disable(logging.WARNING)  # corner warns the root logger where draws are too few for contours
    style = {"color": BLUE, "label_kwargs": small, "title_kwargs": small, "title_fmt": ".3g", "show_titles": True}
    try:
        figure = corner.corner(np.column_stack(columns), labels=labels, quantiles=(0.05, 0.5, 0.95), **style)
    finally:
        logging.disable(before)
    figure.set_size_inches(2.2 * len(columns) + 1.0, 2.2 * len(columns) + 1.0)
    return save(figure, path, grid=False)


def draw_bands(calibration: Calibration, path: Path) -> Path:
    """Draw every channel of every log over length, with the predicted 90 % band."""
    from matplotlib.figure import Figure

    from probe_agents.records.drawing import BLUE, GREY, escape_dollars, save

    cases = calibration.cases
    present = [name for name in CHANNELS if any(name in case.metres.measured for case in cases)]
    figure = Figure(figsize=(4.6 * len(cases) + 1.0, 2.1 * len(present) + 0.6), layout="constrained")
    axes = figure.subplots(len(present), len(cases), squeeze=False, sharex="col", sharey="row")
    for number, case in enumerate(cases):
        low, middle, high = calibration.bands(number)
        names = [CHANNELS[k] for k in calibration.posterior.likelihood.chosen[number]]
        for axis, name in zip(axes[:, number], present, strict=True):
            label, scale = LABELS[CHANNELS.index(name)]
            if number == 0:
                axis.set_ylabel(label, fontsize=8)
            if name not in names:
                continue
            column, x = names.index(name), case.metres.length
            axis.fill_between(x, scale * low[:, column], scale * high[:, column], color=BLUE, alpha=0.2, linewidth=0)
            axis.plot(x, scale * middle[:, column], color=BLUE, linewidth=1.0, label="expected, with 90 %")
            axis.plot(x, scale * case.metres.measured[name], ".", color="black", markersize=3.0, label="log")
            if name != "root_tension":
                axis.set_yscale("log")
        axes[0][number].set_title(escape_dollars(case.name), fontsize=9, color=GREY)
        axes[-1][number].set_xlabel("inserted length [m]")
    axes[0][0].legend(fontsize=7, loc="best")
    return save(figure, path)
