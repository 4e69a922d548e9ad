"""What a simulation can report: a step beyond the known limit, and a state that diverged."""

from __future__ import annotations


class StabilityWarning(UserWarning):
    """The time step is beyond the method's known stable limit, or the couple of (9) feeds a pressed probe."""


class SimulationError(RuntimeError):
    """The simulated state diverged.

    Attributes:
        method, time_step: what was used.
        time: time reached [s].
        node: the worst node, counted from the tip.
        stable_time_step: the step that is known to hold [s]; 0 if none is.
    """

    def __init__(self, method: str, time_step: float, time: float, node: int, distance: float, stable: float) -> None:
        self.method, self.time_step, self.time, self.node = method, time_step, time, node
        self.distance_from_tip, self.stable_time_step = distance, stable
        if stable == 0.0:
            hint = "no time step is known to hold for this scene: raise probe.damping_time or nodes_per_pitch"
        elif time_step > stable:
            hint = f"a time step of {stable:.2g} s or less is known to hold for this scene"
        else:
            hint = (
                f"the step is within the known limit of {stable:.2g} s: most likely the cable was compressed and"
                " buckled between its floats, which a shorter step does not change; contact.cable = true lays it"
                " against the walls"
            )
        super().__init__(
            f"{method} with time_step {time_step:g} s diverged at t = {time:.6g} s;"
            f" worst at node {node}, {distance:g} m from the tip; {hint}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        """Keep the error picklable, so that it can leave a worker process."""
        arguments = (self.method, self.time_step, self.time, self.node, self.distance_from_tip, self.stable_time_step)
        return type(self), arguments
