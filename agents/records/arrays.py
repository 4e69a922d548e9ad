"""Moved to ``probe_env.npz``."""

from probe_env.npz import read_arrays

__all__ = ["read_arrays"]
