"""What the machine grants: cores."""

import os


def available_cores() -> int:
    """Cores that this process may run on: its affinity on Linux, elsewhere all there are; at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    count = getattr(os, "process_cpu_count", os.cpu_count)  # the former from Python 3.13 on
    return count() or 1
