"""Sensor model: what motion does to the signals, and what flaws are found; see docs/signal.md."""
