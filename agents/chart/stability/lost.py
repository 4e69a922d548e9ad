"""Insertions that diverge with floats alone, again on nodes, with the cable on the walls and without.

Two sets: the random designs of ``any-probe`` whose episodes diverged, the same policies in the same tubes; and table
2's probe fed in as hard as the tasks' device can through tubes of much friction. A closed loop goes another way where
the simulator differs, so what is compared is whether an insertion ends, not its reward.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.policies.catalogue import named_policies
from agents.policies.fixed import Constant
from agents.policies.places import place_at
from agents.records.code_hash import code_hash
from agents.records.reading import read_csv
from agents.records.store import Store
from agents.rollouts.plan import Plan
from agents.rollouts.playing import Playing, Unit
from agents.terminal.work import Work, announce
from probe_env.envs.contexts import Ranges, draw_context
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import BOTH_WAYS

CODE: Final = (
    "agents.chart.stability.lost:run_lost", "agents.chart.stability.lost:hard_plan",
    "probe_env.envs.episodes:Episodes.reset", "probe_env.envs.episodes:Episodes.step",
    "agents.policies.fixed:BUILT_IN.predict", "agents.policies.fixed:Scheduled",
    "agents.policies.on_map:MAP_POLICIES", "agents.policies.bundle:Agent",
)  # fmt: skip
KEYS: Final = ("set", "policy", "context", "seed", "cable")
SETS: Final = {"any probe": "random", "hard feed": "scene"}
"""Set -> probes of its plan."""
FIDELITY: Final = BOTH_WAYS["fast"]
SHOWN: Final = (
    "friction", "helix_diameter", "float_pitch", "flexural_rigidity", "inspected_m", "radial_rms_m", "lost_drive",
)  # fmt: skip
HARD: Final = "0.4 m/s, 130 m3/h"
HARD_TUBES: Final = 16
HARD_FRICTION: Final = (0.20, 0.35)
SEED: Final = 22


def diverged_episodes(episodes: Path) -> list[Unit]:
    """Policy, context and seed of the episodes of ``any-probe`` that diverged."""
    table = read_csv(episodes)
    rows: list[Any] = table[table["diverged"] > 0][["policy", "context", "seed"]].to_dict("records")
    return [(str(row["policy"]), int(row["context"]), int(row["seed"])) for row in rows]


def any_plan(policies: list[str], cable: bool) -> Plan:
    """The plan of the stage any-probe, simulated on nodes."""
    place = place_at(None, "test")
    config = place.config.all_shown
    named = named_policies([_spec(name) for name in policies], config, place.vibration)
    return Plan(named, place.contexts, (0,), _walls(config, cable), FIDELITY, "random")


def _spec(name: str) -> str:
    """A policy as the stage any-probe names it: agents by their training seed."""
    agent, at, seed = name.partition("@")
    return f"{name}=results/agents/{agent}/seed-{seed}/agent.npz" if at else name


def hard_plan(cable: bool) -> Plan:
    """Table 2's probe in drawn tubes of much friction, at the fastest feed with the most air."""
    rng, config = np.random.default_rng(SEED), TaskConfig().all_shown
    contexts = [draw_context(rng, ranges=Ranges(friction=HARD_FRICTION)) for _ in range(HARD_TUBES)]
    policy = Constant(config, config.feed_speeds[1], config.air_supply_rates[1])
    return Plan({HARD: policy}, contexts, (0,), _walls(config, cable), FIDELITY)


def _walls(config: TaskConfig, cable: bool) -> TaskConfig:
    return config.model_copy(update={"scene": {"contact": {"cable": cable}}})


def run_lost(plan: Plan, units: list[Unit], key: Mapping[str, Any], threads: int) -> list[dict[str, Any]]:
    """Episodes of a plan side by side, a row each; ``key`` is what rows have besides their unit."""
    playing = Playing(plan, deque(units), len(units), threads)
    rows: list[dict[str, Any]] = []
    with tqdm(total=len(units), desc=f"{key['set']}, contact.cable = {key['cable']}", unit="insertion") as bar:
        while not playing.over:
            for ended in playing.step():
                policy, context, seed = ended.unit
                probe = plan.config.scene.probe.model_dump() | (ended.probe or {})
                known = plan.contexts[context].model_dump() | probe | ended.kpis
                row = {"policy": policy, "context": context, "seed": seed, "diverged": bool(ended.kpis["diverged"])}
                rows.append(dict(key) | row | {name: known[name] for name in SHOWN})
                bar.update()
    return rows


def rerun(episodes: Path, output: Path, limit: int = 0, threads: int = 1) -> pd.DataFrame:
    """What is not stored yet in insertions.csv.

    Args:
        episodes: the table of ``any-probe``.
        output: folder of the table.
        limit: the first so many insertions of a set; 0: all.
        threads: at most so many.
    """
    store = Store(output / "insertions.csv", KEYS, lambda row: code_hash(CODE, FIDELITY.method))
    units = {
        "any probe": diverged_episodes(episodes)[: limit or None],
        "hard feed": [(HARD, k, 0) for k in range(limit or HARD_TUBES)],
    }
    wanted = [(name, *unit, cable) for name in SETS for cable in (True, False) for unit in units[name]]
    announce(Work("insertion", len(wanted), lambda: sum(store.has(*key) for key in wanted), store.path))
    for name in SETS:
        for cable in (True, False):
            todo = [unit for unit in units[name] if not store.has(name, *unit, cable)]
            if todo:
                policies = list(dict.fromkeys(policy for policy, _, _ in todo))
                plan = hard_plan(cable) if name == "hard feed" else any_plan(policies, cable)
                store.add(*run_lost(plan, todo, {"set": name, "cable": cable}, threads))
    return store.table


def markdown(table: pd.DataFrame) -> str:
    """A row a tube of a weak cable, and one for hard feeding: how many insertions end, on nodes."""
    heads = "insertions", "probe", "in how many", "end with floats alone", "end with the cable on the walls"
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    weak, hard = (table[table["set"] == name] for name in SETS)
    for context, part in weak.groupby("context"):
        first = part.iloc[0]
        tube = f"any probe, tube {context} ({first['helix_diameter']:g} m, friction {first['friction']:.2f})"
        lines.append(_line(tube, part))
    low, high = HARD_FRICTION
    lines.append(_line(f"{HARD}, friction {low:g} to {high:g}", hard))
    return "\n".join(lines)


def _line(what: str, part: pd.DataFrame) -> str:
    first, ended = part.iloc[0], ~part["diverged"].astype(bool)
    on = part["cable"].astype(bool)
    probe = f"EI {first['flexural_rigidity']:.3f} N m², floats every {1e3 * first['float_pitch']:.0f} mm"
    return f"| {what} | {probe} | {int(on.sum())} | {int((ended & ~on).sum())} | {int((ended & on).sum())} |"
