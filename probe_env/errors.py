"""Warnings and errors of a simulation."""


class StabilityWarning(UserWarning):
    """The time step is beyond the known stable limit, or the couple of (9) adds energy to a compressed probe."""


class SimulationError(RuntimeError):
    """The simulated state diverged.

    Attributes:
        method, time_step: of the simulation.
        time: time of the divergence [s].
        node: node with the largest displacement, counted from the tip.
        distance_from_tip: of that node [m].
        stable_time_step: largest step known to be stable [s]; 0 if none is known.
    """

    def __init__(self, method: str, time_step: float, time: float, node: int, distance: float, stable: float) -> None:
        self.method, self.time_step, self.time, self.node = method, time_step, time, node
        self.distance_from_tip, self.stable_time_step = distance, stable
        if stable == 0.0:
            hint = (
                f"no time step is known to be stable with {method} for this scene: try a shorter one, or increase"
                " probe.damping_time or nodes_per_pitch"
            )
        elif time_step > stable:
            hint = f"a time step of {stable:.2g} s or less is known to be stable for this scene"
        else:
            hint = (
                f"the step is within the known limit of {stable:.2g} s: most likely the cable buckled between floats,"
                " which never unloads in the model of the study; a shorter step does not help; terms.shortening = true"
                " lets it unload, contact.cable = true makes the walls support it"
            )
        super().__init__(
            f"{method} with time_step {time_step:g} s diverged at t = {time:.6g} s;"
            f" worst at node {node}, {distance:g} m from the tip; {hint}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        """Make the error picklable, for worker processes."""
        arguments = (self.method, self.time_step, self.time, self.node, self.distance_from_tip, self.stable_time_step)
        return type(self), arguments
