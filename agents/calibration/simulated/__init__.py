"""Simulated insertions whose truth is known: the response is learnt from them, and calibrations are tested on them."""

from __future__ import annotations
