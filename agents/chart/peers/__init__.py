"""The same chain in other programs."""
