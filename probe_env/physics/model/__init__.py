"""The lumped-mass model: a scene enters, the arrays that kernels take leave: chain, drive, state, and what calls them.

Imports scenes, settings and errors only.
"""
