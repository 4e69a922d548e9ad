"""What a log says of its plant: both enter; friction, stiffness, drag and damping leave, with intervals.

``simulated`` is what the response is learnt from. Imports logs, records and terminal, plants, the physics'
model and closed forms.
"""

from __future__ import annotations
