"""Trials of probe designs, in sections of constant length or in whole insertions."""

from probe_env.envs.trials.candidates import Candidate, Stretch, Trial, check_measure, judge, stretch_of
from probe_env.envs.trials.insertions import try_insertions
from probe_env.envs.trials.players import Controller, Foresighted, Players, periods_of
from probe_env.envs.trials.sections import check_candidate, sections_of, try_sections

__all__ = [
    "Candidate", "Controller", "Foresighted", "Players", "Stretch", "Trial", "check_candidate", "check_measure",
    "judge", "periods_of", "sections_of", "stretch_of", "try_insertions", "try_sections",
]  # fmt: skip
