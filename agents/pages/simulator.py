"""Speed, accuracy and stability of the simulator in words."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from agents.bench import scaling as portioned
from agents.bench import walls
from agents.chart import other_probes as probes
from agents.chart import tables as chart
from agents.chart import timelapse as lapses
from agents.chart.costs import REPEATS
from agents.chart.peers import comparison as others
from agents.chart.stability import lost, pressed_words, returns
from agents.chart.stability import map as stability_map
from agents.pages.sources import RESULTS, source
from agents.pages.sources import markdown as table_of
from agents.records.models import Record
from agents.records.reading import read_csv, read_json
from agents.records.store import stored_rows
from agents.study.back import SETTLING, SLOW_MEMBERS
from agents.study.back import load_rows as load_trips
from agents.study.back_claims import back_findings
from agents.study.cases import load_rows
from agents.study.claims import findings, markdown
from agents.study.root_tables import root_markdown
from agents.study.roots import load_rows as load_roots

PRESSED = RESULTS / "pressed"
FIGURES = ("ns_per_node_step", "node_step_ratio", "simulated_second_ratio")
"""Of a method in the bench: cost, and ratios of the study's scheme to it."""


def study() -> str:
    """The study's claims against what was simulated."""
    folder = RESULTS / "study"
    table = load_rows(folder)
    members = int(table.groupby("case").size().max())
    origin = source(folder / "ensemble-provenance.json")
    note = f"Mean and range of {members} runs a case, 8 s each, statistics from 2 s on. {origin}"
    return f"{markdown(findings(table))}\n\n{note}"


def back() -> str:
    """The return beside the insertion."""
    folder = RESULTS / "study"
    table = load_trips(folder)
    members = int(table.groupby("case").size().max())
    note = (
        f"Mean and range of {members} runs a case ({SLOW_MEMBERS} of newmark); statistics over 6 s, from 2 s on, or"
        f" from {2.0 + SETTLING:g} s on where the start has died. {source(folder / 'back-provenance.json')}"
    )
    return f"{markdown(back_findings(table))}\n\n{note}"


def root() -> str:
    """The root's place in a pitch."""
    folder = RESULTS / "study"
    table = load_roots(folder)
    members = int(table.groupby("case").size().max())
    note = (
        f"Means with 95 % intervals of {members} runs a case that differ by 0.1 µm at the start, 6 s each, from 2 s on;"
        f" a growing probe has the length half-way. {source(folder / 'root-provenance.json')}"
    )
    return f"{root_markdown(table)}\n\n{note}"


def bench() -> str:
    """Speeds as ratios within one run."""
    path = RESULTS / "bench" / "bench.json"
    results = read_json(path, Record).model_dump()
    lines = ["| solver, l = 50 m | ns a node-step | times the TICM's |", "|---|---|---|"]
    for name, row in results["solvers"].items():
        lines.append(f"| {name} | {row['ns_per_node_step']:.0f} | {row['times_ticm']:.1f} |")
    lines += [
        "",
        "| method, l = 50 m, one thread | step | ns a node-step | node-step ratio | ratio for a simulated second |"
        " in single rounds |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in results["fast"].items():
        cells = [row[figure] for figure in FIGURES]
        low, high = (row[f"simulated_second_ratio_{end}"] for end in ("low", "high"))
        shown = " | ".join(f"{cell:.1f}" for cell in cells)
        lines.append(f"| {name} | {row['time_step_s']:g} s | {shown} | {low:.1f} to {high:.1f} |")
    insertion = results["insertion"]
    lines += [
        "",
        f"A full insertion, 5 to 60 m at 0.2 m/s, takes {insertion['time_lapse_1']:.1f} s a probe (16 probes,"
        f" {results['machine']['cores']} cores), with time-lapse 4 {insertion['time_lapse_4']:.1f} s.",
    ]
    scaling = results["scaling"]
    note = (
        f"Best of {results['repeats']} rounds, in which all take their turns. Cost of a step grows with the number of"
        f" nodes to the power {scaling['exponent']:.3f}"
        f" ({scaling['nodes'][0]} to {scaling['nodes'][-1]} nodes). A new process has its first result after"
        f" {results['first_result_s']:.1f} s with cached kernels. {source(path)}"
    )
    return "\n".join(lines) + f"\n\n{note}"


def idle_cable() -> str:
    """Cost of the cable's contact where it does not act."""
    path = RESULTS / "bench" / "bench.json"
    rows = read_json(path, Record).model_dump()["idle_cable"]
    note = "Processor times of rounds that take turns, groups as wide as a register, one thread."
    return f"{table_of(walls.HEADER, walls.cells(rows))}\n\n{note} {source(path)}"


def environments() -> str:
    """Steps a second of the environments."""
    path = RESULTS / "bench" / "bench.json"
    results = read_json(path, Record).model_dump()
    rows = results["environments"]
    rates, episode, alone = rows["steps_per_second"], rows["episode_s_per_probe"], rows["episode_s_alone"]
    lines = ["| environments | steps/s | times the single one |", "|---|---|---|"]
    lines += [f"| {name} | {rate:.0f} | {rate / rates['single']:.1f} |" for name, rate in rates.items()]
    note = (
        f"Steps of 0.1 s of `Snapshot-v1` with {rows['carrier_length_m']:g} m of carrier cable. Outside the kernel a"
        f" batch of 16 spends {100.0 * rows['share_outside_kernel']:.0f} % of its time. A whole `Insertion-v1` episode"
        f" at 0.2 m/s costs {episode['standard']:.1f} s a probe with `standard`, {episode['fast']:.1f} s with `fast`"
        f" (batch of 16, all cores); alone {alone['standard']:.1f} s and {alone['fast']:.1f} s."
        f" Of that, signal-to-noise takes {_percent(rows['share_listening'])}, alone"
        f" {_percent(rows['share_listening_alone'])} (`standard` and `fast`)."
    )
    return "\n".join(lines) + f"\n\n{note} {source(path)}"


def _percent(shares: Mapping[str, float]) -> str:
    """Two shares in words."""
    return f"{100.0 * shares['standard']:.1f} and {100.0 * shares['fast']:.1f} %"


def _chart_errors(converged: bool) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors at constant length and over insertions as the chart stored them."""
    folder, suffix = RESULTS / "chart", "-converged" if converged else ""
    return read_csv(folder / f"errors{suffix}.csv"), read_csv(folder / f"insertion-errors{suffix}.csv")


def smooth() -> str:
    """Slopes and errors before chaos."""
    folder = RESULTS / "chart"
    return f"{chart.smooth(stored_rows(folder / 'smooth.csv'))} {source(folder / 'smooth-provenance.json')}"


def choices() -> str:
    """The cheapest setting for a tolerance."""
    table = chart.choices_markdown(chart.choices(*_chart_errors(False)))
    return f"{table}\n\n{source(RESULTS / 'chart' / 'ensembles-provenance.json')}"


def presets() -> str:
    """Error and cost of the presets."""
    costs = read_csv(RESULTS / "chart" / "costs.csv")
    table = chart.presets(*_chart_errors(True), costs)
    bench = read_json(RESULTS / "bench" / "bench.json", Record).model_dump()["fast"]["imex32, 8 lanes"]
    table += (
        f" (Best of {REPEATS} in one run; the bench, another run, has {bench['simulated_second_ratio']:.0f} for"
        " `imex32` at 2e-4 s: such ratios hang on the processor, which the records name.)"
    )
    return f"{table}\n\n{source(RESULTS / 'chart' / 'insertions-provenance.json')}"


def outputs() -> str:
    """Errors of all outputs."""
    return chart.outputs(_chart_errors(True)[0], (50.0,))


def superelement() -> str:
    """Meshes and superelements at 2e-4 s and nearby against the converged mesh."""
    constant = _chart_errors(True)[0]
    nodes = (constant["method"] == "imex32") & ((constant["time_step_s"] == 2e-4) | (constant["nodes_per_pitch"] == 16))
    shown = constant[constant["method"].str.startswith("superelement") | nodes]
    note = source(RESULTS / "chart" / "ensembles-provenance.json")
    return f"{chart.outputs(shown, (30.0, 40.0, 50.0))}\n\nRatios of means with 95 % intervals. {note}"


def other_probes() -> str:
    """The usual mesh and step for other probes than table 2's."""
    path = RESULTS / "chart" / "other-probes.csv"
    members = probes.MEMBERS
    note = (
        f"Ratios of the means of {members['standard']} runs at `standard` to those of {members['converged']} with"
        f" sixteen nodes a pitch at 5e-5 s, {probes.INSERTED:g} m inside, with 95 % intervals."
        f" {source(path.with_name(f'{path.stem}-provenance.json'))}"
    )
    return f"{probes.markdown(stored_rows(path))}\n\n{note}"


def timelapse() -> str:
    """What time-lapse changes."""
    folder = RESULTS / "timelapse"
    return f"{lapses.markdown(read_csv(folder / 'summary.csv'))}\n\n{source(folder / 'provenance.json')}"


def stability() -> str:
    """Steps that hold, and those that are wrong."""
    folder = RESULTS / "stability"
    return (
        f"{stability_map.markdown(read_csv(folder / 'map.csv'))}\n\n{source(folder / 'provenance.json')}\n\n"
        f"{returns.markdown(stored_rows(PRESSED / 'map.csv'))}\n\n{source(PRESSED / 'map-provenance.json')}"
    )


def pressed_scenes() -> str:
    """Which of two hundred pressed scenes end finite."""
    table, origin = stored_rows(PRESSED / "scenes.csv"), source(PRESSED / "scenes-provenance.json")
    return f"{pressed_words.markdown(table)}\n\n{origin}"


def lost_insertions() -> str:
    """Insertions that diverge with floats alone, with the cable on the walls."""
    table, origin = stored_rows(PRESSED / "insertions.csv"), source(PRESSED / "insertions-provenance.json")
    return f"{lost.markdown(table)}\n\n{origin}"


def energy() -> str:
    """Energy of passive chains."""
    folder = RESULTS / "stability"
    return f"{chart.energy(read_csv(folder / 'energy.csv'))}\n\n{source(folder / 'provenance.json')}"


def scaling() -> str:
    """What a thousand insertions cost on more cores."""
    folder = RESULTS / "scaling"
    portions, jobs = (read_csv(folder / f"{name}.csv") for name in ("portions", "jobs"))
    seconds = portions.set_index("size")["seconds_an_insertion"]
    times = ", ".join(f"{value:.1f} s in portions of {size}" for size, value in seconds.items())
    one, more = jobs.iloc[0], jobs.iloc[-1]
    return (
        f"{portioned.markdown(read_csv(folder / 'projection.csv'))}\n\n"
        f"Measured: an insertion costs {times} (one thread);"
        f" {portioned.MEASURED} insertions take {one['seconds']:.0f} s with one worker,"
        f" {more['seconds']:.0f} s with {more['jobs']:.0f}, their start included. {source(folder / 'provenance.json')}"
    )


def peers() -> str:
    """Other codes on the same scene."""
    folder = RESULTS / "chart"
    return f"{others.markdown(read_csv(folder / 'peers.csv'))}\n\n{source(folder / 'peers-provenance.json')}"
