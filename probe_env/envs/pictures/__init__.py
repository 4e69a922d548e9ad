"""What is drawn of a probe: simulators and episodes enter, RGB pictures leave.

Pictures of an episode (the helix, what was done and felt) and of the motion near the tip, in small steps of time. What
stays is drawn once and kept. Imports the episodes and the physics; with it comes matplotlib.
"""
