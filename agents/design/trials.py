"""How probe designs are tried, by a comparison and by a search."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from agents.policies.cases import TABLE_2, Named
from agents.policies.catalogue import make_policy
from agents.policies.fixed import Scheduled
from agents.policies.policy import Policy
from agents.records.manifest import commit, write_json
from agents.records.models import Stored, read_json
from agents.records.searches import JOURNAL
from probe_env import Context, Design, Fidelity
from probe_env.envs.task import TaskConfig
from probe_env.envs.trials import Candidate, judge, try_insertions, try_sections
from probe_env.envs.vibration_map import VibrationMap
from probe_env.schedule import Schedule

TUBE_FILE: Final = "tube.json"


class Tube(Stored):
    """``tube.json``: the plant that the trials in a folder are of."""

    name: str
    digest: str


@dataclass(frozen=True)
class DesignTrials:
    """How designs are tried: tubes, feed, task and fidelity.

    Attributes:
        contexts: tubes.
        feed: a policy by its spec; for sections it must be a schedule over inserted length.
        full: whole insertions instead of sections of constant length.
        fidelity: of the simulation, resolved for the scene.
        config: the task, with the scene that designs and contexts change.
        vibration: the map that some policies look things up in; default: the shipped one.
        tube: what the plant is called.
    """

    contexts: Sequence[Context]
    feed: str = "constant"
    full: bool = False
    fidelity: Fidelity = field(default_factory=Fidelity)
    config: TaskConfig = field(default_factory=lambda: TaskConfig().full_observation)
    vibration: VibrationMap | None = None
    tube: Named = TABLE_2

    def policy(self) -> Policy:
        """The feed as a policy.

        Raises:
            ValueError: there is no such policy.
        """
        return make_policy(self.feed, self.config, self.vibration)

    def schedule(self) -> Schedule:
        """The feed as a schedule.

        Raises:
            ValueError: it is none over inserted length.
        """
        policy = self.policy()
        if self.feed == "constant":
            return Schedule("inserted_length", "linear", (5.0,), (0.2,), (63.0 / 3600.0,))
        if not isinstance(policy, Scheduled) or policy.schedule.over != "inserted_length":
            raise ValueError(
                f"feed = {self.feed!r} is not a schedule over inserted length: give --full for policies and agents"
            )
        return policy.schedule

    def key(self, design: Design, context: Context, index: int = 0) -> str:
        """Identity of one result; the index of the context seeds the start."""
        parts = [index, design.built.model_dump(), context.model_dump(), self.policy().describe()]
        return self._hashed(parts)[:16]

    def _hashed(self, parts: Sequence[Any]) -> str:
        """Hash of some parts and all that is common to all trials."""
        common = [self.full, self.fidelity.model_dump(), self.config.model_dump(mode="json")]
        text = json.dumps([*parts, *common, version("probe-env"), commit()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def setting(self) -> dict[str, Any]:
        """What a manifest says of the trials."""
        return {"feed": self.feed, "full": self.full, "fidelity": self.fidelity.model_dump()}

    def run(
        self,
        pairs: Sequence[tuple[Design, Context]],
        seeds: Sequence[int],
        threads: int | None = None,
        feed: Schedule | None = None,
    ) -> list[dict[str, float]]:
        """KPIs and reward of some pairs, in one batch; ``feed``: another schedule."""
        candidates = [
            Candidate(design, context, feed or (self.policy() if self.full else self.schedule()), seed)
            for (design, context), seed in zip(pairs, seeds, strict=True)
        ]
        tried = try_insertions if self.full else try_sections
        trial = tried(candidates, self.config, self.fidelity, threads=threads)
        terms, kpis = judge([design for design, _ in pairs], trial, self.config)
        rewards = np.sum(list(terms.values()), axis=0)
        return [
            {"reward": float(rewards[k])} | {name: float(values[k]) for name, values in kpis.items()}
            for k in range(len(pairs))
        ]


def claim(output: Path, tube: Named) -> None:
    """Write down which plant the trials in a folder are of; a folder with trials that does not say is of table 2.

    Raises:
        ValueError: it holds trials of another plant; nothing is changed.
    """
    path = output / TUBE_FILE
    before = read_json(path, Tube) if path.exists() else Tube(name=TABLE_2.name, digest=TABLE_2.digest)
    in_use = path.exists() or any((output / name).exists() for name in ("designs.jsonl", JOURNAL, "trials.csv"))
    if in_use and before.digest != tube.digest:
        other = "" if before.name != tube.name else ", as its file was then"
        problem = f"holds trials in the tubes of {before.name}{other}, not of {tube.name}: choose another folder"
        raise ValueError(f"output = {str(output)!r} {problem}")
    if tube != TABLE_2:
        write_json(path, {"name": tube.name, "digest": tube.digest})


def tube_column(tube: Named) -> dict[str, str]:
    """Column of a table that names its plant; none for the tubes of table 2."""
    return {"tube": tube.title} if tube.title else {}
