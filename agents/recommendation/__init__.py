"""The schedule for a plant: the best that can be expected over what is known of it."""

from __future__ import annotations
