"""Insertions whose truth is known: drawn plants enter; a fitted response and the errors of calibrations leave.

Imports calibration, logs, processes, records and terminal, plants and episodes; torch in ``fit`` alone.
"""

from __future__ import annotations
