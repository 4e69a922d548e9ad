"""Methods that advance a chain in time: arrays enter, the state moves on in them, a status leaves.

``METHODS`` in ``method`` is the only list of them; a method is a file of kernels and an entry there.
Imports the chain, the drive and the state below.
"""
