"""Speed: kernels, environments and worker processes enter, times and ratios of one run leave.

Imports rollouts, processes, records, the environments, the physics, and Stable-Baselines3 with its batch to time them.
"""
