"""What the README and docs say of the stored results: a maker a block, named after it."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd

from agents import agent_results, design_compare, scaling, stability_map, timelapse
from agents.catalogue import DATA
from agents.chart import peers
from agents.chart import tables as chart
from agents.chart.costs import REPEATS
from agents.chart.report import error_tables
from agents.claims import markdown
from agents.fidelity_check import words
from agents.report import compared_with, kpi_cells
from agents.statistics import KPIS, Interval, endings, grouped, sentences
from agents.study import load_rows

RESULTS = Path("results")
TRIED = "ppo-tension-teacher"
BARS = ("best-schedule", "best-schedule-by-diameter", "tension-scheduled")
METHODS = ("constant", "best-constant", "best-schedule", "best-schedule-by-diameter", "pi", "tension-scheduled",
           "ppo-no-tension", "ppo", "privileged")  # fmt: skip
DESIGN_TABLES = {
    "countermeasures": "The study's countermeasures (its section 4.3) one by one, in sections of constant length at its"
    " 0.2 m/s and 63 m3/h, {tubes} held-out tubes:",
    "confirmed": "The design found against the study's two, in whole insertions at the study's feed, {tubes} held-out"
    " tubes; changes are against the improved probe:",
    "confirmed-finely": "The same at the finest setting, `reference`, on {tubes} of the tubes:",
}


def _source(path: Path) -> str:
    made: dict[str, Any] = json.loads(path.read_text())
    machine = made["machine"]
    return (
        f"Made by `{made['command']}` at commit {made['commit']}, {machine['cores']} cores"
        f" ({machine['processor']}), numba {made['packages']['numba']}; stored in `{path.parent}/`."
    )


def _study() -> str:
    folder = RESULTS / "study"
    table = load_rows(folder)
    members = int(table.groupby("case").size().max())
    source = _source(folder / "provenance.json")
    note = f"Mean and range of {members} runs a case, 8 s each, statistics from 2 s on. {source}"
    return f"{markdown(table)}\n\n{note}"


def _bench() -> str:
    path = RESULTS / "bench" / "bench.json"
    results = json.loads(path.read_text())
    lines = ["| solver, l = 50 m | ns a node-step | times the TICM's |", "|---|---|---|"]
    for name, row in results["solvers"].items():
        lines.append(f"| {name} | {row['ns_per_node_step']:.0f} | {row['times_ticm']:.1f} |")
    lines += [
        "",
        "| method, l = 50 m, one thread | step | ns a node-step | node-step ratio | ratio for a simulated second |",
        "|---|---|---|---|---|",
    ]
    for name, row in results["fast"].items():
        cells = (row["ns_per_node_step"], row["node_step_ratio"], row["simulated_second_ratio"])
        lines.append(f"| {name} | {row['time_step_s']:g} s | " + " | ".join(f"{cell:.1f}" for cell in cells) + " |")
    insertion = results["insertion"]
    lines += [
        "",
        f"A full insertion, 5 to 60 m at 0.2 m/s, takes {insertion['time_lapse_1']:.1f} s a probe (16 probes,"
        f" {results['machine']['cores']} cores), with time-lapse 4 {insertion['time_lapse_4']:.1f} s.",
    ]
    scaling = results["scaling"]
    note = (
        f"Cost of a step grows with the number of nodes to the power {scaling['exponent']:.3f}"
        f" ({scaling['nodes'][0]} to {scaling['nodes'][-1]} nodes). A new process has its first result after"
        f" {results['first_result_s']:.1f} s with cached kernels. {_source(path)}"
    )
    return "\n".join(lines) + f"\n\n{note}"


def _environments() -> str:
    path = RESULTS / "bench" / "bench.json"
    results = json.loads(path.read_text())
    rows = results["environments"]
    rates, episode = rows["steps_per_second"], rows["episode_s_per_probe"]
    lines = ["| environments | steps/s | times the single one |", "|---|---|---|"]
    lines += [f"| {name} | {rate:.0f} | {rate / rates['single']:.1f} |" for name, rate in rates.items()]
    note = (
        f"Steps of 0.1 s of `Snapshot-v0` with {rows['carrier_length_m']:g} m of carrier cable. Outside the kernel a"
        f" batch of 16 spends {100.0 * rows['share_outside_kernel']:.0f} % of its time. A whole `Insertion-v0` episode"
        f" at 0.2 m/s costs {episode['standard']:.1f} s a probe with `standard`, {episode['fast']:.1f} s with `fast`"
        " (batch of 16, all cores)."
    )
    return "\n".join(lines) + f"\n\n{note} {_source(path)}"


def _evaluation() -> str:
    folder = RESULTS / "evaluation"
    table = grouped(pd.read_csv(folder / "episodes.csv"))
    against = compared_with(folder, table)
    shown = [kpi for kpi in KPIS if kpi not in ("inspected_share", "radial_p99_m")]
    names = [f"{KPIS[kpi][0]} [{KPIS[kpi][2]}]" if KPIS[kpi][2] else KPIS[kpi][0] for kpi in shown]
    lines = [f"| policy | {' | '.join(names)} |", "|---" * (len(shown) + 1) + "|"]
    for policy, cells in kpi_cells(table):
        by_kpi = dict(zip(KPIS, cells, strict=True))
        lines.append(f"| `{policy}` | " + " | ".join(by_kpi[kpi] for kpi in shown) + " |")
    ends = endings(table)
    words = "\n".join(f"* {line}" for line in sentences(table, against))
    note = (
        f"{len(table)} insertions on {table['context'].nunique()} held-out tubes, means with 95 % bootstrap intervals;"
        f" {ends['diverged'].sum()} diverged, {ends['lost_drive'].sum()} lost their drive."
    )
    return "\n".join(lines) + f"\n\n{words}\n\n{note} {_source(folder / 'provenance.json')}"


def _agents() -> str:
    table = grouped(pd.read_csv(RESULTS / "evaluation" / "episodes.csv"))
    lines = [f"* {line}" for line in agent_results.verdicts(table, "ppo", BARS, "privileged")]
    curves = agent_results.load_curves(RESULTS / "agents" / "ppo")
    run = json.loads((RESULTS / "agents" / "ppo" / f"seed-{curves['seed'].max()}" / "run.json").read_text())
    imitation = run["config"]["imitation"]
    speed = agent_results.throughput(curves, imitation["rounds"] * imitation["steps"])
    best = curves.loc[curves.groupby("seed")["reward"].idxmax()]
    lines.append(
        f"* PPO improved on the warm start in {int((best['phase'] > 0).sum())} of {len(best)} seeds by the validation"
        " tubes; in the others the warm start itself was kept."
    )
    note = (
        "Interquartile means over training seeds, 95 % intervals over seeds and tubes. Training:"
        f" {speed['minutes_a_seed']:.0f} minutes a seed (median) with one thread"
        f" ({run['machine']['cores']} cores shared by two seeds), {speed['steps_per_second']:.0f} environment steps/s,"
        f" {100.0 * speed['kernel_share']:.0f} % of the time in the simulation kernel. Made by `{run['command']}` at"
        f" commit {run['commit']}; weights, learning curves and settings are stored in `results/agents/`."
    )
    methods = [name for name in METHODS if name in set(table["policy"])]
    return f"{agent_results.markdown(table, methods)}\n\n" + "\n".join(lines) + f"\n\n{note}"


def _tried() -> str:
    """The recipe that was trained, evaluated and not shipped, beside the one that is."""
    folder = RESULTS / "agents" / TRIED
    curves, shipped = (agent_results.load_curves(RESULTS / "agents" / name) for name in (TRIED, "ppo"))
    test = pd.read_csv(folder / "test.csv")
    best, before = (c.groupby("seed")["reward"].max().mean() for c in (curves, shipped))
    gained = curves.loc[curves.groupby("seed")["reward"].idxmax()]
    lost = test[test["lost_drive"].astype(bool)]
    kept = test.groupby("policy")["reward"].mean()
    return (
        "Tried and not shipped: the warm start from `tension-scheduled` and three phases of PPO"
        f" (`configs/train/{TRIED}.toml`). PPO improved on the warm start in {int((gained['phase'] > 0).sum())} of"
        f" {len(gained)} seeds, and validation is better, {best:.1f} against {before:.1f} (means of the seeds' best)."
        f" On the test tubes {lost['policy'].nunique()} of the seeds lost the drive in {len(lost)} of {len(test)}"
        f" insertions, which none of the shipped agents does; mean rewards there by seed:"
        f" {', '.join(f'{value:.1f}' for value in kept)}. Curves, weights and episodes are stored in `{folder}/`."
    )


def _map() -> str:
    quality = json.loads((DATA / "vibration-map.json").read_text())
    share = 100.0 * quality["explained_variance"]
    return (
        f"The map is fitted to {quality['episodes']} wandering insertions on the training tubes. Of every eighth, left"
        f" out of the fit (helix diameters 1.2, 1.7 and 2.5 m), it tells {share:.0f} % of the variance of log rms."
        f" Made by `{quality['command']}` at commit {quality['commit']}; stored in `agents/data/`."
    )


def _designs() -> str:
    parts = []
    for name, title in DESIGN_TABLES.items():
        folder = RESULTS / "design" / name
        table = design_compare.cells(pd.read_csv(folder / "summary.csv"))
        made = json.loads((folder / "provenance.json").read_text())
        tubes = pd.read_csv(folder / "designs.csv")["context"].nunique()
        lines = [title.format(tubes=tubes), "", f"| {' | '.join(design_compare.HEADER)} |"]
        lines += ["|---" * len(design_compare.HEADER) + "|", *(f"| {' | '.join(row)} |" for row in table)]
        parts.append("\n".join(lines) + f"\n\nMade by `{made['command']}` at commit {made['commit']}.")
    return "\n\n".join(parts)


def _search() -> str:
    folder = RESULTS / "design" / "search"
    influence, made = pd.read_csv(folder / "sensitivity.csv"), json.loads((folder / "provenance.json").read_text())
    front = pd.read_csv(folder / "front.csv")
    rows = influence[influence["objective"] == "mean_square_ratio"].to_dict("records")
    rows.sort(key=lambda row: -abs(row["coefficient"]))
    told = ", ".join(
        f"{row['parameter'].replace('_', ' ')} {row['coefficient']:+.2f} [{row['low']:+.2f}, {row['high']:+.2f}]"
        for row in rows
    )
    design = tomllib.loads((folder / "found.toml").read_text())
    fields = ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in design.items())
    return (
        f"{made['trials']} designs on {made['contexts']} training tubes, {len(front)} on the front. What vibration"
        f" depends on (standardised rank regression over the trials): {told}. The design with the best reward by the"
        f" task's weights (SI units): {fields}. {_source(folder / 'provenance.json')}"
    )


def _tradeoff() -> str:
    folder = RESULTS / "tradeoff"
    volumes = pd.read_csv(folder / "hypervolume.csv")
    contexts = pd.read_csv(folder / "episodes.csv")["context"].nunique()
    parts = [
        f"`{row['family']}` {Interval(row['hypervolume'], row['low'], row['high']).text()}"
        for row in volumes.to_dict("records")
    ]
    return (
        f"Hypervolume (share of the box from nothing to 900 s and all of the length out of the limit that a front"
        f" dominates): {', '.join(parts)}; {contexts} tubes. {_source(folder / 'provenance.json')}"
    )


def _fidelity() -> str:
    folder = RESULTS / "fidelity"
    lines = [f"* {line}" for line in words(pd.read_csv(folder / "fidelity.csv"))]
    return "\n".join(lines) + f"\n\n{_source(folder / 'provenance.json')}"


def _timelapse() -> str:
    folder = RESULTS / "timelapse"
    return f"{timelapse.markdown(pd.read_csv(folder / 'summary.csv'))}\n\n{_source(folder / 'provenance.json')}"


def _stability() -> str:
    folder = RESULTS / "stability"
    return f"{stability_map.markdown(pd.read_csv(folder / 'map.csv'))}\n\n{_source(folder / 'provenance.json')}"


@lru_cache
def _chart_errors() -> tuple[pd.DataFrame, pd.DataFrame]:
    return error_tables(RESULTS / "chart")


def _smooth() -> str:
    folder = RESULTS / "chart"
    return f"{chart.smooth(pd.read_csv(folder / 'smooth.csv'))} {_source(folder / 'smooth-provenance.json')}"


def _choices() -> str:
    table = chart.choices_markdown(chart.choices(*_chart_errors()))
    return f"{table}\n\n{_source(RESULTS / 'chart' / 'ensembles-provenance.json')}"


def _presets() -> str:
    costs = pd.read_csv(RESULTS / "chart" / "costs.csv")
    table = chart.presets(*_chart_errors(), costs)
    bench = json.loads((RESULTS / "bench" / "bench.json").read_text())["fast"]["imex32, 8 lanes"]
    table += (
        f" (Best of {REPEATS} in one run; the bench, another run, has {bench['simulated_second_ratio']:.0f} at 2e-4 s:"
        " such ratios move by as much from run to run.)"
    )
    return f"{table}\n\n{_source(RESULTS / 'chart' / 'insertions-provenance.json')}"


def _outputs() -> str:
    return chart.outputs(_chart_errors()[0])


def _energy() -> str:
    folder = RESULTS / "stability"
    return f"{chart.energy(pd.read_csv(folder / 'energy.csv'))}\n\n{_source(folder / 'provenance.json')}"


def _scaling() -> str:
    folder = RESULTS / "scaling"
    portions, jobs = (pd.read_csv(folder / f"{name}.csv") for name in ("portions", "jobs"))
    seconds = portions.set_index("size")["seconds_an_insertion"]
    told = ", ".join(f"{value:.1f} s in portions of {size}" for size, value in seconds.items())
    one, more = jobs.iloc[0], jobs.iloc[-1]
    return (
        f"{scaling.markdown(pd.read_csv(folder / 'projection.csv'))}\n\n"
        f"Measured: an insertion costs {told} (one thread);"
        f" {scaling.MEASURED} insertions take {one['seconds']:.0f} s with one worker,"
        f" {more['seconds']:.0f} s with {more['jobs']:.0f}, their start included. {_source(folder / 'provenance.json')}"
    )


def _peers() -> str:
    folder = RESULTS / "chart"
    return f"{peers.markdown(pd.read_csv(folder / 'peers.csv'))}\n\n{_source(folder / 'peers-provenance.json')}"


MAKERS: dict[str, Callable[[], str]] = {
    "study": _study,
    "bench": _bench,
    "environments": _environments,
    "evaluation": _evaluation,
    "agents": _agents,
    "tried": _tried,
    "map": _map,
    "designs": _designs,
    "search": _search,
    "tradeoff": _tradeoff,
    "fidelity": _fidelity,
    "timelapse": _timelapse,
    "stability": _stability,
    "smooth": _smooth,
    "choices": _choices,
    "presets": _presets,
    "outputs": _outputs,
    "energy": _energy,
    "scaling": _scaling,
    "peers": _peers,
}
