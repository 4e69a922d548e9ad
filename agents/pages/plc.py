"""The law for a plant's PLC in words: its constants, what it reaches, its text."""

from __future__ import annotations

from typing import Final

import pandas as pd

from agents.evaluation.report import kpi_cells
from agents.pages import control
from agents.pages.headroom import BAR, BLURRED, SHARE, lead_of, with_planner
from agents.pages.sources import RESULTS, command, markdown, source, stored_table, ways_to_fail
from agents.plant.plc_export import DESCRIPTIONS, HEADER, structured_text
from agents.policies.places import place_of
from agents.policies.plc import trim_search
from agents.policies.plc.law import STORED, Constants, PlantData, read_constants
from agents.policies.plc.trimmed import STORED as TRIM
from agents.policies.plc.trimmed import read_trim
from agents.records.columns import shown_of
from agents.records.models import Figures
from agents.records.reading import read_json
from agents.records.tables import read_episodes
from agents.rollouts.comparison import probability_of_improvement
from agents.rollouts.statistics import failures, grouped, paired_difference, share_of_lead

FOLDER = RESULTS / "control"
FRESH = RESULTS / "fresh"
LEADS = ("law", "beside", "reward less that of the other", "earns more in [% of the tubes]")
FINELY = RESULTS / "laws-finely"
LAW = "trimmed-law"
FINELY_BESIDE = ("plc-law", "adaptive", "tension-scheduled")
RIVALS = ("best-schedule-by-diameter", "tension-scheduled", "adaptive")
BESIDE: Final[dict[str, tuple[str, ...]]] = {"plc-law": RIVALS, "trimmed-law": (*RIVALS, "plc-law")}
"""Laws, and what each is compared with."""
SHOWN = ("reward", "inspection_time_s", "share_within_limit")


def plc_constants() -> str:
    """The ten constants and how they were found."""
    stored = read_json(STORED, Figures)
    searched = stored.model_extra or {}
    record, tubes, rewards = stored.provenance.model_dump(), searched["tubes"], searched["rewards"]
    simulated = (
        f", then {rewards['simulated']:.1f} in simulation on {tubes['simulated']}" if "simulated" in rewards else ""
    )
    return (
        f"{markdown(HEADER, _rows(read_constants()))}\n\n"
        f"Found by CMA-ES on training tubes only: mean reward {rewards['map']:.1f} by the map on {tubes['map']}"
        f"{simulated}. Made by `{command(record)}` at commit {record['commit']}; every trial is in"
        " `agents/policies/data/plc-law-trials.csv`."
    )


def plc_reached() -> str:
    """The laws beside other policies on the held-out tubes."""
    table = grouped(read_episodes(FOLDER / "episodes.csv"))
    played, tried_out = with_planner(table), with_planner(table, BLURRED)
    header, rows = _shown(table)
    led = [(*row, lead_of(played, row[0].strip("`"))) for row in rows]
    closed = " and ".join(
        f"`{law}` closes {share_of_lead(tried_out, law, BLURRED, BAR).text(100.0)} %" for law in BESIDE
    )
    return (
        f"{markdown((*header, SHARE), led)}\n\n{_beside(table)} Of the gap between `{BAR}` and `{BLURRED}`"
        f" {closed}. {table['context'].nunique()} held-out tubes at `fast`, paired, 95 %"
        f" intervals; `ppo` is its training seed 0. {source(FOLDER / 'provenance.json')}"
    )


def plc_fresh() -> str:
    """The laws beside other policies on tubes of which nothing was known when they were made."""
    table = grouped(read_episodes(FRESH / "episodes.csv"))
    return (
        f"{markdown(*_shown(table))}\n\n{_beside(table)} {table['context'].nunique()} fresh tubes at `fast`,"
        f" paired, 95 % intervals; `ppo` is its training seed 0. {source(FRESH / 'provenance.json')}"
    )


def plc_finely() -> str:
    """What the laws earn at `reference`, and what moves there and at half the step."""
    table = grouped(read_episodes(FINELY / "finer-acting" / "episodes.csv"))
    leads = (f"`{rival}` {paired_difference(table, LAW, rival, 'reward').text()}" for rival in FINELY_BESIDE)
    return (
        f"**At `reference` the reward of `{LAW}` less that of others is: {', '.join(leads)}** (paired, 95 % intervals,"
        f" {table['context'].nunique()} tubes).\n\n{control.checked(FINELY)}"
    )


def _shown(table: pd.DataFrame) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header, and a row a policy."""
    known = shown_of(table.columns)
    names = (f"{known[kpi][0]} [{known[kpi][2]}]" if known[kpi][2] else known[kpi][0] for kpi in SHOWN)
    cells = ((policy, dict(zip(known, values, strict=True))) for policy, values in kpi_cells(table))
    return ("policy", *names), [(f"`{policy}`", *(by_kpi[kpi] for kpi in SHOWN)) for policy, by_kpi in cells]


def _beside(table: pd.DataFrame) -> str:
    """What the laws earn more than others, tube by tube, and how many of their insertions failed."""
    rows = []
    for law, rivals in BESIDE.items():
        for rival in rivals:
            gain = paired_difference(table, law, rival, "reward").text()
            rows.append((f"`{law}`", f"`{rival}`", gain, probability_of_improvement(table, law, rival).text(100.0)))
    laws = table[table["policy"].isin(BESIDE)]
    return f"{markdown(LEADS, rows)}\n\n{int(failures(laws).sum())} of their {len(laws)} insertions {ways_to_fail()}."


def trim() -> str:
    """The grid of the trim's two constants."""
    stored = read_json(TRIM, Figures)
    searched, chosen = stored.model_extra or {}, read_trim()
    record = stored.provenance.model_dump()
    trials = stored_table(TRIM.with_name("trimmed-law-trials.csv"), "aim", "time", "gain", "gain_low", "gain_high")
    return (
        f"{markdown(trim_search.HEADER, trim_search.cells(trials))}\n\n"
        f"Reward less that of `{trim_search.UNTRIMMED}`, by the noise that is aimed at and the trim's time, paired,"
        f" with 95 % intervals, on {searched['tubes']} training tubes. `trimmed-law` aims at"
        f" {1e6 * chosen.aim:.3g} µm in {chosen.time:g} s. Made by `{command(record)}` at commit"
        f" {record['commit']}; all of it is in `agents/policies/data/trimmed-law-trials.csv`."
    )


def plc_text() -> str:
    """Its structured text for table 2's plant."""
    return f"```text\n{structured_text(read_constants(), PlantData.of(place_of(None, 'test').config))}```"


def _rows(constants: Constants) -> list[tuple[str, ...]]:
    """A row a constant."""
    return [(name, f"{value:.4g}", *DESCRIPTIONS[name]) for name, value in constants.model_dump().items()]
