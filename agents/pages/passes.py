"""What a probe that is drawn back shows: where it is worth to look, and how gently the feed has to turn round."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pandas as pd

from agents.evaluation import feed_changes as changes_study
from agents.evaluation import passes as passes_study
from agents.evaluation import turning as turning_study
from agents.learning import results as agent_results
from agents.pages.sources import RESULTS, command, markdown, source, stored_table
from agents.policies.places import both_ways, place_of
from agents.recommendation import both_ways as search
from agents.records.models import Record
from agents.records.reading import read_json
from agents.records.tables import read_episodes
from agents.rollouts.bootstrap import Interval
from agents.rollouts.statistics import failures, grouped, paired_difference
from probe_env.envs.task import TaskConfig
from probe_env.schedule import Schedule

PASSES = (
    "probe", "policy", "inspects", "tubes", "reward", "inspection_time_s", "share_within_limit", "gain",
    passes_study.DEPTH,
)  # fmt: skip

BACK = ("fast-in", "steady-back", "slow-back")
"""Schedules that look on the way back."""
FORTH = ("trimmed-law", "tension-scheduled", "best-schedule")
"""Policies that look on the way in."""
SEARCHED = search.NAME
"""The schedule that was searched for most reward."""
FED = {"feed_speed": 1.0, "air_supply_rate": 3600.0}
"""Column of a schedule -> factor of the unit for people."""
ACTING = RESULTS / "passes-acting"
"""Planners and agents of both ways beside schedules."""
AGENT = "both-ways"
LIKE = 1.0
"""Reward that a trial may be behind the best and be called as good."""
PAIRED = (
    ("fast-in", "best-schedule"), ("steady-back", "tension-scheduled"), ("steady-back", "trimmed-law"),
    ("slow-back", "best-schedule"),
)  # fmt: skip
"""Looking on the way back, and a policy of the way in: all but the first take about as long with table 2's probe."""
LESS = ("probe", "looks back", "looks on the way in", "a90 less its [% wall]", "where its way back counts too")
TURNING = (
    *turning_study.KEYS, *turning_study.SHOWN,
    *(f"{column}{end}" for column in turning_study.CHANGES.values() for end in ("", "_low", "_high")),
)  # fmt: skip


def passes() -> str:
    """Where it is worth to look."""
    folder = RESULTS / "passes"
    summary, figures = stored_table(folder / "passes.csv", *PASSES), read_json(folder / "provenance.json", Record)
    entries: list[dict[str, Any]] = summary.to_dict("records")  # type: ignore[assignment]
    of_original = {(entry["policy"], entry["inspects"]): entry for entry in entries if entry["probe"] == "original"}
    improved = next(e for e in entries if (e["probe"], e["policy"], e["inspects"]) == ("improved", "fast-in", "best"))
    way_back = ", ".join(_way_back(name, of_original[name, "back"]) for name in BACK)
    way_in = ", ".join(_way_in(name, of_original[name, "in"]) for name in FORTH)
    either = ", ".join(_depth(of_original[name, "best"]) for name in FORTH)
    best = {
        probe: max((entry for entry in entries if entry["probe"] == probe), key=lambda entry: float(entry["reward"]))
        for probe in passes_study.PROBES
    }
    record = figures.model_dump()
    fed = ", ".join(f"`{name}` {_fed(name)}" for name in (*BACK, SEARCHED))
    return (
        f"**With table 2's probe, fed in fast, flaws are found on the way back {way_back}. On the way in they are found"
        f" {way_in}; from {either} on where the way back, at full speed, is looked at as well.**"
        f" With the improved probe {_depth(improved)} takes {improved['inspection_time_s']:.0f} s, at full speed and"
        " looking both ways. Shares are of the wall, times of both ways. The most reward in millimetres has"
        f" {_best(best['original'])} with table 2's probe, and {_best(best['improved'])} with the study's improved"
        f" one. {_bound(best)}\n\n{_paired()}\n\n"
        f"{markdown(passes_study.FOUND, passes_study.found_cells(summary))}\n\n"
        "Reward, and in brackets what it is more than that of looking on the way in by"
        f" `{passes_study.BESIDE}`, paired, with 95 % intervals:\n\n"
        f"{markdown(passes_study.REWARDS, passes_study.reward_cells(summary))}\n\n"
        f"Simulated at `{record['fidelity']}`, means over {record['limit']} test tubes, which are balanced over"
        " the diameters. Policies of the way in come back as fast as the device can. `original` is table 2's probe,"
        f" `improved` the study's. Fed in and drawn back: {fed}. a90/95 is the depth that is found with 90 % over the"
        " tubes, with 95 % confidence; `either` is what is found where either way calls it, each with half of the false"
        f" calls. {_overloaded()} Made by `{command(record)}` at commit {record['commit']}."
    )


def _overloaded() -> str:
    """In how many tubes the root tension passes its limit, by policy."""
    table = read_episodes(RESULTS / "passes" / "episodes.csv")
    table = table[(table["inspects"] == passes_study.PLAYED) & (table["probe"] == "original")]
    tubes = (table["cost_tension"] > 0.0).groupby(table["policy"], sort=False).sum()
    counts = ", ".join(f"{count} by `{policy}`" for policy, count in tubes.items())
    return (
        f"The root tension passes {TaskConfig().tension_limit:g} N with table 2's probe, for"
        f" {table['cost_tension'].max():.0f} control periods at most, in so many of {table['context'].nunique()} tubes:"
        f" {counts}."
    )


def _bound(best: dict[str, dict[str, Any]]) -> str:
    """What is left for any policy to earn above the best that was played with each probe."""
    table, parts = read_episodes(RESULTS / "passes" / "episodes.csv"), []
    config = both_ways(place_of(None, "test"), passes_study.PLAYED).config
    for probe, entry in best.items():
        metres = float(table.loc[table["probe"] == probe, "inspected_m"].max())
        most = passes_study.most_reward(config, metres)
        parts.append(f"{most:.1f} ({most - entry['reward']:.1f} more, {probe})")
    return (
        "No policy, planner or agent can earn more than one that nothing shakes, fed and drawn as fast as the device"
        f" can with the least air: {' and '.join(parts)}."
    )


def _paired() -> str:
    """What looking on the way back finds beside policies of the way in, tube by tube."""
    table, rows = read_episodes(RESULTS / "passes" / "episodes.csv"), []
    for probe in passes_study.PROBES:
        part = table[table["probe"] == probe]
        seconds = part.groupby("policy")["inspection_time_s"].mean()
        part = part.assign(policy=part["policy"] + "/" + part["inspects"])
        for back, forth in PAIRED:
            less = (
                paired_difference(part, f"{back}/back", f"{forth}/{looks}", "a90_percent_wall").text()
                for looks in ("in", "best")
            )
            rows.append((probe, *(f"`{name}` ({seconds[name]:.0f} s)" for name in (back, forth)), *less))
    return (
        "a90 of the way back less that of the way in, tube by tube, with 95 % intervals; less than nothing is better:"
        f"\n\n{markdown(LESS, rows)}"
    )


def _ways(name: str) -> tuple[Schedule, Schedule]:
    """Of a shipped schedule."""
    path = Path("configs") / "schedules" / f"{name}.csv"
    forth, back = Schedule.read(path), Schedule.read_back(path)
    assert back is not None
    return forth, back


def _fed(name: str) -> str:
    """Feed and air of a shipped schedule, in and back."""
    ways = _ways(name)
    feeds, airs = (" and ".join(f"{k * getattr(way, column)[0]:.3g}" for way in ways) for column, k in FED.items())
    return f"{feeds} m/s with {airs} m³/h"


def _way_back(name: str, entry: dict[str, Any]) -> str:
    return f"from {_depth(entry)} on at {_ways(name)[1].feed_speed[0]:g} m/s ({entry['inspection_time_s']:.0f} s)"


def _way_in(name: str, entry: dict[str, Any]) -> str:
    return f"from {_depth(entry)} on by `{name}` ({entry['inspection_time_s']:.0f} s)"


def _depth(entry: dict[str, Any]) -> str:
    return f"{entry[passes_study.DEPTH]:.0f} %"


def _best(entry: dict[str, Any]) -> str:
    return f"`{entry['policy']}` looking at {passes_study.LOOKS[entry['inspects']]}"


def passes_search() -> str:
    """The searched schedule, what else is as good, and what it earns in tubes that the search did not see."""
    place = RESULTS / "optimise-passes" / f"{search.NAME}.json"
    trials = stored_table(place.with_name(f"{search.NAME}-trials.csv"), *search.COLUMNS, *search.KPIS)
    searched = read_json(place, Record).model_extra or {}
    alike = trials[trials["reward"] > trials["reward"].max() - LIKE]
    rows = [
        (name, f"{trials[column].min():.3g} to {trials[column].max():.3g}", f"{searched['schedule'][column]:.3g}",
         f"{alike[column].min():.3g} to {alike[column].max():.3g}")
        for name, column in zip(search.HEADER[1:], search.COLUMNS, strict=False)
    ]  # fmt: skip
    table = read_episodes(RESULTS / "passes" / "episodes.csv")
    table = table[table["inspects"] == passes_study.PLAYED]
    own, other = (table[table["probe"] == probe] for probe in passes_study.PROBES)
    lost = [int(part.loc[part["policy"] == search.NAME, "lost_drive"].sum()) for part in (own, other)]
    header = ("", "tried", f"`{search.NAME}`", f"within {LIKE:g} of its reward")
    return (
        f"{markdown(header, rows)}\n\n"
        f"`{search.NAME}` has the most reward of {len(trials)} trials by a Gaussian process, each played in"
        f" {searched['training_tubes']} training tubes: {trials['reward'].max():.1f}. {_as_good(trials)}"
        f" More than `fast-in` earns, paired: {Interval(**searched['gain']).text()} in {searched['validation_tubes']}"
        f" validation tubes and {paired_difference(own, search.NAME, BACK[0], 'reward').text()} in"
        f" {own['context'].nunique()} test tubes, of which {lost[0]} lose the drive; with the improved probe, for which"
        f" it was not searched, {lost[1]} do. {source(place)}\n\n{_improved(place)}"
    )


def _as_good(trials: pd.DataFrame) -> str:
    """How many schedules, tried once or more, are about as good as the best."""
    different = trials.drop_duplicates(list(search.COLUMNS))
    count = int((different["reward"] > different["reward"].max() - LIKE).sum()) - 1
    return f"{count} other{' comes' if count == 1 else 's come'} within {LIKE:g}."


def _improved(place: Path) -> str:
    """What the same search comes to with the improved probe."""
    name = search.called("improved")
    place = place.with_name(f"{name}.json")
    searched = read_json(place, Record).model_extra or {}
    trials = stored_table(place.with_name(f"{name}-trials.csv"), *search.COLUMNS, *search.KPIS)
    feed_in, air_in, feed_back, air_back = (f"{searched['schedule'][column]:.3g}" for column in search.COLUMNS)
    safe = (searched["ranges"][search.COLUMNS[k]] for k in (1, 3))
    (least, _), (_, most) = safe
    return (
        f"With the improved probe, of which {least:.0f} m³/h in and {most:.0f} back are safe, {searched['trials']}"
        f" trials come to {feed_in} m/s with {air_in} m³/h in, {feed_back} m/s with {air_back} back, reward"
        f" {searched['reward']:.1f}. {_as_good(trials)} {_over_the_first(trials, searched)} {source(place)}"
    )


def _over_the_first(trials: pd.DataFrame, searched: dict[str, Any]) -> str:
    """What the best of a search earns more than its first trial: as fast as it goes, with the study's air if safe."""
    first = trials.iloc[0][list(search.COLUMNS)].to_dict()
    if all(math.isclose(value, searched["schedule"][name], rel_tol=1e-5) for name, value in first.items()):
        return "The best is the first of them."
    gain, tubes = Interval(**searched["gain"]).text(), searched["validation_tubes"]
    return f"More than the first of them earns, paired: {gain} in {tubes} validation tubes."


def passes_acting() -> str:
    """What looking ahead wins on both ways, and what an agent does, beside the best of four numbers."""
    table = grouped(read_episodes(ACTING / "episodes.csv"))
    names = list(dict.fromkeys(table["policy"]))
    gains = {name: agent_results.difference(table, name, SEARCHED, "reward").text() for name in names}
    lines = "\n".join(f"* `{name}` less `{SEARCHED}`: reward {gains[name]}." for name in names if name != SEARCHED)
    curves = agent_results.load_curves(RESULTS / "agents" / AGENT)
    run = read_json(RESULTS / "agents" / AGENT / "seed-0" / "run.json", Record).model_dump()
    config = both_ways(place_of(None, "test"), passes_study.PLAYED).config
    most = passes_study.most_reward(config, float(table["inspected_m"].max()))
    return (
        f"{agent_results.markdown(table, names)}\n\n{lines}\n\n"
        f"Looking at {passes_study.LOOKS[passes_study.PLAYED]}, {table['context'].nunique()} test tubes, which are"
        " balanced over the diameters; interquartile means over training seeds, 95 % intervals over seeds and tubes;"
        f" {int(failures(table).sum())} of {len(table)} inspections failed. No policy can earn more than {most:.1f}."
        f" `{AGENT}` was trained by `{run['command']}` at commit {run['commit']}: {curves['steps'].max():,} steps of"
        f" PPO a seed after its imitation of `{SEARCHED}`. {source(ACTING / 'provenance.json')}"
    )


def turning() -> str:
    """What a gentler turn is worth, and what time-lapse on the way in makes of it."""
    folder = RESULTS / "turning"
    summary = stored_table(folder / "turning.csv", *TURNING)
    record = read_json(folder / "provenance.json", Record).model_dump()
    usual, gentle = turning_study.RAMPS[0], turning_study.RAMPS[-1]
    lapsed, alone = turning_study.FIDELITIES
    rows = {tuple(row[key] for key in turning_study.KEYS): row for row in summary.to_dict("records")}
    gained, deeper = (
        ", ".join(f"{_interval(rows[policy, *key], column)} by `{policy}`" for policy in turning_study.POLICIES)
        for key, column in (((gentle, alone), "by_ramp"), ((usual, lapsed), "by_time_lapse"))
    )
    return (
        f"{markdown(turning_study.HEADER, turning_study.cells(summary))}\n\n"
        f"Looking on the way back. Paired, a90 with a ramp of {gentle:g} m/s² less that with {usual:g} m/s², at"
        f" `{alone}`: {gained} [% of the wall]; a90 at `{lapsed}` less that at `{alone}`, {usual:g} m/s²: {deeper}."
        f" At the turn the root tension passes {TaskConfig().tension_limit:g} N {_overloaded_turns()}."
        f" Brackets are 95 % intervals over {record['limit']} balanced test tubes; table 2's probe. `{alone}` is"
        f" `{lapsed}` without its time-lapse on the way in. Made by `{command(record)}` at commit {record['commit']}."
    )


def _overloaded_turns() -> str:
    """In how many tubes it does with each ramp, whatever the policy and the fidelity: the most of them."""
    table = read_episodes(RESULTS / "turning" / "episodes.csv")
    table = table[table["cost_tension"] > 0.0]
    counts = {
        ramp: table[table["ramp"] == ramp].groupby(["policy", "fidelity"])["context"].nunique().max()
        for ramp in turning_study.RAMPS
    }
    return ", ".join(f"with {ramp:g} m/s² in {0 if pd.isna(count) else count} tubes" for ramp, count in counts.items())


def _interval(row: dict[Any, Any], name: str) -> str:
    return Interval(row[name], row[f"{name}_low"], row[f"{name}_high"]).text()


def feed_changes() -> str:
    """What a change of the feed on the way back does."""
    folder = RESULTS / "feed-changes"
    table = stored_table(folder / "changes.csv", *changes_study.COLUMNS)
    tubes = ", ".join(f"{length:g} m in a helix of {diameter:g} m" for length, diameter in changes_study.TUBES)
    return (
        f"{markdown(changes_study.HEADER, changes_study.cells(table))}\n\n"
        f"Greatest radial rms [mm] of {changes_study.SPAN:g} s, from when the feed leaves {-changes_study.FROM:g} m/s"
        f" until {changes_study.AFTER:g} s after it has come to {-changes_study.TO:g} m/s, at the ramps of the header:"
        f" the least and the greatest of {len(changes_study.TUBES)} scenes, means of"
        f" {table['member'].nunique()} starts. Cable and helix are {tubes}, with the friction that makes the number on"
        f" the left; constant length, table 2's probe, nodes as at `fast`. {source(folder / 'provenance.json')}"
    )
