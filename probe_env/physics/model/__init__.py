"""The lumped-mass model: a scene enters, the arrays that kernels take leave: chain, drive, state.

``kernel_call`` checks what they are called with. Imports scenes and arrays.
"""
