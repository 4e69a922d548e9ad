"""Studies of calibration on simulated logs, and the training of its response."""
