"""Trials of probe designs, for comparisons and searches."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from probe_agents.policies.cases import TABLE_2, PlantLabel
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.fixed import Scheduled
from probe_agents.policies.policy import Policy
from probe_agents.records.result_folder import ResultFolder
from probe_env import Context, Design, Fidelity
from probe_env.envs.task import TaskConfig
from probe_env.envs.trials import Candidate, score_designs, try_insertions, try_sections
from probe_env.envs.vibration_map import VibrationMap
from probe_env.schedule import Schedule


@dataclass(frozen=True)
class DesignTrials:
    """Settings of trials: tubes, feed, task and fidelity.

    Attributes:
        contexts: tubes.
        feed: policy spec; for sections a schedule over inserted length.
        full: simulate whole insertions instead of sections of constant length.
        fidelity: simulation settings, resolved for the scene.
        config: task; designs and contexts replace parts of its scene.
        vibration: vibration map of policies; default: the shipped one.
        plant_label: name of the plant.
    """

    contexts: Sequence[Context]
    feed: str = "constant"
    full: bool = False
    fidelity: Fidelity = field(default_factory=Fidelity)
    config: TaskConfig = field(default_factory=lambda: TaskConfig().full_observation)
    vibration: VibrationMap | None = None
    plant_label: PlantLabel = TABLE_2

    def policy(self) -> Policy:
        """Make the policy of ``feed``."""
        return make_policy(self.feed, self.config, self.vibration)

    def schedule(self) -> Schedule:
        """Make the schedule of ``feed``."""
        policy = self.policy()
        if self.feed == "constant":
            return Schedule("inserted_length", "linear", (5.0,), (0.2,), (63.0 / 3600.0,))
        if not isinstance(policy, Scheduled) or policy.schedule.over != "inserted_length":
            raise ValueError(
                f"feed = {self.feed!r} is not a schedule over inserted length: use --full for policies and agents"
            )
        return policy.schedule

    def key(self, design: Design, context: Context, index: int = 0) -> str:
        """Identity of one result; the index of the context is the seed of its initial state."""
        parts = [index, design.built.model_dump(), context.model_dump(), self.policy().describe()]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]

    def folder(self, path: Path, **settings: Any) -> ResultFolder:
        """The folder of trials with these settings of all trials and further ones."""
        name, digest, _ = self.plant_label
        common = {"tube": {"name": name, "digest": digest}, "full": self.full, "fidelity": self.fidelity.model_dump()}
        identity = common | settings | {"task": self.config.model_dump(mode="json")}
        return ResultFolder(path, identity, "these trials were simulated")

    @property
    def setting(self) -> dict[str, Any]:
        """Settings for the manifest."""
        return {"feed": self.feed, "full": self.full, "fidelity": self.fidelity.model_dump()}

    def run(
        self,
        pairs: Sequence[tuple[Design, Context]],
        seeds: Sequence[int],
        threads: int | None = None,
        feed: Schedule | None = None,
    ) -> list[dict[str, float]]:
        """KPIs and reward of (design, tube) pairs, simulated in one batch; ``feed`` replaces the schedule."""
        candidates = [
            Candidate(design, context, feed or (self.policy() if self.full else self.schedule()), seed)
            for (design, context), seed in zip(pairs, seeds, strict=True)
        ]
        simulate = try_insertions if self.full else try_sections
        trial = simulate(candidates, self.config, self.fidelity, threads=threads)
        terms, kpis = score_designs([design for design, _ in pairs], trial, self.config)
        rewards = np.sum(list(terms.values()), axis=0)
        return [
            {"reward": float(rewards[k])} | {name: float(values[k]) for name, values in kpis.items()}
            for k in range(len(pairs))
        ]


def tube_column(label: PlantLabel) -> dict[str, str]:
    """Column of a table that names its plant; none for the tubes of table 2."""
    return {"tube": label.title} if label.title else {}
