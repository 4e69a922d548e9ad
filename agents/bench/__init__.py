"""Speed: kernels, environments and worker processes enter, times and ratios of one run leave.

Imports rollouts, processes and the environments.
"""
