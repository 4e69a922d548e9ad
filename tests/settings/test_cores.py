"""The cores of this process are counted on every system."""

import os

import pytest

from probe_env import Scene, SimulatorBatch
from probe_env.machine import available_cores


def test_linux_counts_those_it_may_run_on(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 3, 5}, raising=False)
    assert available_cores() == 3


@pytest.mark.parametrize(("newer", "older", "cores"), [(6, 8, 6), (None, 8, 8), (None, None, 1)])
def test_without_affinity_a_batch_takes_all_there_are(monkeypatch, newer, older, cores):
    """As on macOS and Windows; ``process_cpu_count`` came with Python 3.13."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(os, "process_cpu_count", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: older)
    if newer is not None:
        monkeypatch.setattr(os, "process_cpu_count", lambda: newer, raising=False)
    assert available_cores() == cores
    assert SimulatorBatch([Scene(carrier_length=1.0)]).threads == cores
