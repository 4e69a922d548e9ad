"""The lumped-mass model: arrays of a chain, its state and its drive, made from a scene."""
