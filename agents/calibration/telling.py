"""A calibration on the terminal: what was assumed and found, and whether the model can have made the logs."""

from __future__ import annotations

from agents.calibration.calibration import Calibration
from agents.calibration.unknowns import UNKNOWNS
from agents.terminal.tables import print_table, print_terms


def print_calibration(calibration: Calibration, own: bool = True) -> None:
    """Print figures, intervals and the verdict; ``own``: whether a file says what the tubes are."""
    rows = []
    for k, name in enumerate(calibration.tubes):
        where = f" in {name}" if len(calibration.tubes) > 1 else ""
        rows.append((f"friction{where}", *_cells(calibration.summary("friction", k)), ""))
        if sliding := calibration.sliding[k]:
            mean, low, high = sliding.friction
            rows.append(
                (f"friction{where} by the tension alone", *_cells({"mean": mean, "low": low, "high": high}), "")
            )
    for name in UNKNOWNS:
        if name in calibration.prior.quantile and name != "friction":
            rows.append((UNKNOWNS[name].text, *_cells(calibration.summary(name)), UNKNOWNS[name].unit))
    print_table("What the logs tell: means with 90 % intervals", ("", "mean", "low", "high", "unit"), rows, left=1)
    terms = {
        "logs": "; ".join(
            f"{case.name}: {len(case.metres)} metres, {', '.join(name.replace('_', ' ') for name in case.metres.felt)}"
            for case in calibration.cases
        )
    }
    terms["taken for"] = _geometry(calibration)
    if not own:
        terms["taken for"] += (
            ". That is table 2's: a --tube says what yours are; another bore or helix tells another friction"
        )
    if calibration.prior.assumed:
        terms["assumed"] = "held possible, for the file says nothing of it: " + "; ".join(calibration.prior.assumed)
    if calibration.prior.known:
        known = (
            f"{UNKNOWNS[name].text} {value:g} {UNKNOWNS[name].unit}" for name, value in calibration.prior.known.items()
        )
        terms["known"] = "by the file: " + "; ".join(text.strip() for text in known)
    print_terms(terms)
    for texts in calibration.beyond:
        for text in texts:
            print_terms({"note": f"beyond what the response was learnt from: {text}"})
    for text in (*calibration.misfits, *calibration.leaning):
        print_terms({"note": text})
    print_terms({"verdict": calibration.verdict})


def _geometry(calibration: Calibration) -> str:
    """The tubes that the logs are taken to be of."""
    tubes = dict.fromkeys(
        (case.scene.tube.inner_diameter, case.scene.tube.helix_diameter, case.scene.probe.carrier_float_diameter)
        for case in calibration.cases
    )
    return "; ".join(
        f"bore {1e3 * bore:g} mm, helix of {helix:g} m, floats of {1e3 * float_diameter:g} mm"
        for bore, helix, float_diameter in tubes
    )


def _cells(summary: dict[str, float]) -> tuple[str, str, str]:
    return tuple(f"{summary[name]:.4g}" for name in ("mean", "low", "high"))  # type: ignore[return-value]
