"""Interactive page on this machine: edit a schedule, watch insertions and compare policies."""
