"""The cores of this process are counted on every system."""

import os

from probe_env import Scene, SimulatorBatch
from probe_env.machine import available_cores


def test_affinity_on_linux_and_all_cores_elsewhere(monkeypatch):
    """``process_cpu_count`` came with Python 3.13."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 3, 5}, raising=False)
    assert available_cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.delattr(os, "process_cpu_count", raising=False)
    assert available_cores() == SimulatorBatch([Scene(carrier_length=1.0)]).threads == 8
    monkeypatch.setattr(os, "process_cpu_count", lambda: 6, raising=False)
    assert available_cores() == 6
