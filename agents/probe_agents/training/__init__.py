"""Trains agents with Stable-Baselines3 and searches their hyperparameters."""
