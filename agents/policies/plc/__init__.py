"""A feedback law of ten constants for a plant's PLC: what a rig measures enters, feed and air leave.

``law`` is the law, ``search`` finds its constants on the vibration map and in simulation, ``export`` writes it as a
table and as IEC 61131-3 structured text. Imports the map, the task and rollouts.
"""
