"""Pictures of a calibration: corner plot of the draws, and what the response expects over the logs."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Final

import numpy as np

from agents.calibration.calibration import Calibration
from agents.calibration.inference import Likelihood
from agents.calibration.metres import CHANNELS
from agents.calibration.response import Response
from agents.calibration.unknowns import UNKNOWNS

UNITS: Final = {
    "root_tension": ("root tension [N]", 1.0),
    "radial_acceleration_rms": ("radial acceleration rms [m/s²]", 1.0),
    "axial_acceleration_rms": ("axial acceleration rms [m/s²]", 1.0),
    "rf_noise_rms": ("radial rms by the noise [mm]", 1e3),
}
DRAWN: Final = 64


def draw_corner(calibration: Calibration, path: Path) -> Path:
    """Draws of every tube's friction and of what all share, one against the other."""
    import corner

    from agents.records.drawing import BLUE, plain, save

    draws, columns, labels = calibration.posterior.draws, [], []
    for column, name in enumerate(UNKNOWNS):
        if name in calibration.prior.known:
            continue
        several = name == "friction" and len(calibration.tubes) > 1
        for tube in range(len(calibration.tubes) if several else 1):
            columns.append(draws[tube, :, column])
            unit = f" [{UNKNOWNS[name].unit}]" if UNKNOWNS[name].unit else ""
            labels.append(UNKNOWNS[name].text + (f"\n{plain(calibration.tubes[tube])}" if several else "") + unit)
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # it tells the root logger where draws are too few for contours
    try:
        figure = corner.corner(
            np.column_stack(columns), labels=labels, quantiles=(0.05, 0.5, 0.95), show_titles=True, title_fmt=".3g",
            color=BLUE, label_kwargs={"fontsize": 9}, title_kwargs={"fontsize": 9},
        )  # fmt: skip
    finally:
        logging.disable(before)
    figure.set_size_inches(2.2 * len(columns) + 1.0, 2.2 * len(columns) + 1.0)
    return save(figure, path)


def draw_bands(calibration: Calibration, response: Response, path: Path) -> Path:
    """Every channel of every log over length, with the band in which nine of ten metres are expected."""
    from matplotlib.figure import Figure

    from agents.records.drawing import BLUE, GREY, GRID, plain, save

    likelihood = Likelihood(response, calibration.cases)
    present = [name for name in CHANNELS if any(name in case.metres.felt for case in calibration.cases)]
    figure = Figure(figsize=(4.6 * len(calibration.cases) + 1.0, 2.1 * len(present) + 0.6), layout="constrained")
    axes = figure.subplots(len(present), len(calibration.cases), squeeze=False, sharex="col", sharey="row")
    rng = np.random.default_rng(0)
    for place, case in enumerate(calibration.cases):
        draws = calibration.posterior.draws[case.tube]
        table = draws[rng.choice(len(draws), min(DRAWN, len(draws)), replace=False)]
        strays, spread = likelihood.strays(place, table)
        mean = likelihood.seen[place] - strays * spread
        sample = 10.0 ** (mean + spread * rng.normal(size=mean.shape))
        low, middle, high = np.quantile(sample, [0.05, 0.5, 0.95], axis=0)
        names = [CHANNELS[k] for k in likelihood.chosen[place]]
        for row, name in enumerate(present):
            axis = axes[row][place]
            axis.grid(**GRID)
            label, scale = UNITS[name]
            if place == 0:
                axis.set_ylabel(label, fontsize=8)
            if name not in names:
                continue
            column, x = names.index(name), case.metres.length
            axis.fill_between(x, scale * low[:, column], scale * high[:, column], color=BLUE, alpha=0.2, linewidth=0)
            axis.plot(x, scale * middle[:, column], color=BLUE, linewidth=1.0, label="expected, with 90 %")
            axis.plot(x, scale * case.metres.felt[name], ".", color="black", markersize=3.0, label="log")
            if name != "root_tension":
                axis.set_yscale("log")
        axes[0][place].set_title(plain(case.name), fontsize=9, color=GREY)
        axes[-1][place].set_xlabel("inserted length [m]")
    axes[0][0].legend(fontsize=7, loc="best")
    return save(figure, path)
