"""From a log to friction, stiffness, drag and damping with intervals."""

from __future__ import annotations
