"""Simulator of many probes: the fast methods compute groups of probes in vector lanes, threads compute groups."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.machine import available_cores
from probe_env.physics.methods.method import Method
from probe_env.physics.simulation.run import CHANNELS, Samples, check_size
from probe_env.physics.simulation.signals import window_statistics
from probe_env.physics.simulation.simulator import Options, Simulator, advance_group
from probe_env.physics.simulation.window import Window
from probe_env.scene import Scene
from probe_env.settings import whole_steps


def groups_of(simulators: Sequence[Simulator], running: Sequence[int]) -> list[list[int]]:
    """Groups of the ``running`` probes: of equal kind, similar length, and at most as many as the method has lanes.

    A group that is faster as single probes is split. All probes have one method.
    """
    kinds: dict[Hashable, list[int]] = {}
    for k in sorted(running, key=lambda k: simulators[k].root):
        kinds.setdefault(simulators[k].method.kind(simulators[k].constants), []).append(k)
    groups: list[list[int]] = []
    for same in kinds.values():
        method = simulators[same[0]].method
        for start in range(0, len(same), method.width):
            group = same[start : start + method.width]
            groups += [[k] for k in group] if len(group) * method.single_fraction < 1.0 else [group]
    return groups


class SimulatorBatch:
    """Simulates N probes together; each is equal bit for bit to a single ``Simulator``.

    Args:
        scenes: one per probe; they may differ in all fields.
        method: as for ``Simulator``; "imex", "superelement" and "explicit" compute four probes at once in vector
            registers, "imex32" and "superelement32" eight. One probe with superelements, or two with
            "superelement32", are computed one by one.
        time_step: [s].
        nodes_per_pitch: nodes in one float pitch.
        threads: greatest number of threads; default: the cores of this process.
        seeds: of the initial perturbation of each probe; default 0, 1, 2, ...
        options: of ``Simulator``, equal for all probes.

    ``kernel_seconds`` is the run time of the kernels, summed over all threads.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        method: str | Method = "imex",
        time_step: float = 2e-4,
        nodes_per_pitch: int = 4,
        *,
        threads: int | None = None,
        seeds: Sequence[int] | None = None,
        **options: Unpack[Options],
    ) -> None:
        if len(scenes) == 0:
            raise ValueError("scenes is empty: a batch needs at least one")
        if threads is not None and threads < 1:
            raise ValueError(f"threads = {threads!r} is outside the accepted range 1 and more")
        seeds = range(len(scenes)) if seeds is None else seeds
        self.threads: Final = threads or available_cores()
        self.simulators = [
            Simulator(scene, method, time_step, nodes_per_pitch, seed=seed, **options)
            for scene, seed in zip(scenes, seeds, strict=True)
        ]
        self.method: Final = self.simulators[0].method
        self.time_step, self.nodes_per_pitch = time_step, nodes_per_pitch
        self.kernel_seconds = 0.0
        # the two samples before a window, for differences at its start; initially at rest
        self._before = [np.zeros((2, 3)) for _ in scenes]

    def __len__(self) -> int:
        return len(self.simulators)

    def __repr__(self) -> str:
        return (
            f"<SimulatorBatch of {len(self)} by {self.method.name}, step {self.time_step:g} s, {self.threads} threads>"
        )

    def branch(self, which: Sequence[int], scenes: Mapping[int, Scene] | None = None) -> SimulatorBatch:
        """A batch of independent copies of some probes in their present state, for predictions.

        Args:
            which: indices of the probes; repeat an index for several copies.
            scenes: new scenes by index, with the same mesh; default: unchanged.

        Raises:
            ValueError: ``which`` is empty or has an invalid index, or a state does not fit its scene.
        """
        if not len(which):
            raise ValueError("which is empty: give at least one index")
        for index, k in enumerate(which):
            if not isinstance(k, int | np.integer) or not -len(self) <= k < len(self):
                raise ValueError(f"which[{index}] = {k!r} is none of {len(self)} probes, counted from 0")
        new = copy.copy(self)
        first = {k: self.simulators[k].branch((scenes or {}).get(k)) for k in set(which)}
        new.simulators = [first[k].branch() for k in which]
        new._before = [self._before[k].copy() for k in which]
        new.kernel_seconds = 0.0
        return new

    def replace(self, index: int, simulator: Simulator) -> None:
        """Replace a probe by another one at rest with equal method, time step and nodes per pitch."""
        here, other = (
            {"method": s.method.name, "time_step": s.time_step, "nodes_per_pitch": s.nodes_per_pitch}
            for s in (self, simulator)
        )
        for name, value in other.items():
            if value != here[name]:
                raise ValueError(f"{name} = {value!r} differs from the batch's {here[name]!r}")
        self.simulators[index] = simulator
        self._before[index] = np.zeros((2, 3))

    def advance(
        self,
        feed_speed: FloatArray | float | None = None,
        air_supply_rate: FloatArray | float | None = None,
        duration: float = 1.0,
        sample_period: float = 1e-3,
        active: npt.NDArray[np.bool_] | None = None,
        keep_samples: bool = False,
    ) -> Window:
        """Advance all active probes by ``duration`` with new targets: a value, (N,) values, or None for unchanged.

        A probe that diverges is reported in the window and no longer advanced; the others continue.

        Raises:
            ValueError: an argument is not valid, or the samples exceed the memory limit; nothing was advanced.
        """
        count = len(self)
        steps = whole_steps("duration", duration, self.time_step)
        every = whole_steps("sample_period", sample_period, self.time_step)
        if steps % every:
            raise ValueError(
                f"duration = {duration!r} s is not a whole number of sample periods of {sample_period:g} s"
            )
        speeds, airs = _targets(feed_speed, count), _targets(air_supply_rate, count)
        for simulator, speed, air in zip(self.simulators, speeds, airs, strict=True):
            simulator.check_targets(speed, air)
        running = self._running(active)
        check_size(steps // every + 2, count)
        samples = {}
        for k in running:
            self.simulators[k].set_targets(speeds[k], airs[k])
            points = np.array([self.simulators[k].sensor, -1], dtype=np.int64)
            samples[k] = Samples(every, points, np.zeros((steps // every, 2, CHANNELS)), np.zeros(0))
        groups = groups_of(self.simulators, running)

        def advanced(group: Sequence[int]) -> float:
            return advance_group([self.simulators[k] for k in group], [samples[k] for k in group], 0, steps)

        with ThreadPoolExecutor(self.threads) as pool:  # starts no thread before its first task
            mapped = pool.map if len(groups) > 1 else map  # starting a thread takes long on a busy processor
            self.kernel_seconds += sum(mapped(advanced, groups))
        signals = np.zeros((count, steps // every + 2, 3))
        for k, (_, _, rows, _) in samples.items():
            signals[k, :2], signals[k, 2:, :2], signals[k, 2:, 2] = self._before[k], rows[:, 0, :2], rows[:, 1, 3]
            self._before[k] = signals[k, -2:].copy()
        diverged = np.array([s.diverged for s in self.simulators])
        good = np.zeros(count, dtype=bool)
        good[running] = True
        good &= ~diverged
        axial, radial, tension = (signals[good, :, field].T for field in range(3))
        statistics: dict[str, FloatArray] = {}
        for name, values in window_statistics(axial, radial, tension, every * self.time_step).items():
            statistics[name] = np.zeros(count)
            statistics[name][good] = values
        new = np.where(good[:, None, None], signals, 0.0)[:, 2:]
        return Window(
            statistics=statistics,
            inserted_length=np.array([s.inserted_length for s in self.simulators]),
            feed_speed=np.array([s.feed_speed for s in self.simulators]),
            air_supply_rate=np.array([s.air_supply_rate for s in self.simulators]),
            diverged=diverged,
            time=every * self.time_step * np.arange(1, new.shape[1] + 1) if keep_samples else None,
            axial=new[:, :, 0].T.copy() if keep_samples else None,
            radial=new[:, :, 1].T.copy() if keep_samples else None,
            tension=new[:, :, 2].T.copy() if keep_samples else None,
        )

    def _running(self, active: npt.NDArray[np.bool_] | None) -> list[int]:
        """Indices of the active probes that have not diverged, after a check of their states."""
        chosen = np.ones(len(self), dtype=bool) if active is None else np.asarray(active, dtype=bool)
        if chosen.shape != (len(self),):
            raise ValueError(f"active has shape {chosen.shape}; ({len(self)},), a value for each probe, is accepted")
        running = [k for k in range(len(self)) if chosen[k] and not self.simulators[k].diverged]
        for k in running:  # before any advances: the kernels check no bounds
            try:
                self.simulators[k].check_fits()
            except ValueError as error:
                raise ValueError(f"probe {k}: {error}") from error
        return running


def _targets(value: FloatArray | float | None, count: int) -> list[float | None]:
    if value is None:
        return [None] * count
    values = np.broadcast_to(np.asarray(value, dtype=float), (count,))
    return [float(v) for v in values]
