"""Moved to ``probe_env.files``."""

from probe_env.files import read_arrays

__all__ = ["read_arrays"]
