"""The schedule for a plant: a plant with what is known of it enters, the best in expectation leaves with what it gains.

Imports calibration, evaluation's report, policies, rollouts, processes and what is below them, plants and the task.
"""

from __future__ import annotations
