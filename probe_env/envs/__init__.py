"""Gymnasium environments of the simulator: episodes, tasks, plants, trials of designs and pictures."""
