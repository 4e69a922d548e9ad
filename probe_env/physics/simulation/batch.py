"""Many probes, those of the fast schemes in lanes, their groups on threads: the batch counterpart of Simulator."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.machine import available_cores
from probe_env.physics.methods import method_named
from probe_env.physics.methods.method import Method
from probe_env.physics.model.state import check_array
from probe_env.physics.simulation.run import CHANNELS, Samples, check_size
from probe_env.physics.simulation.saved import FORMAT, check_format, check_names, check_types
from probe_env.physics.simulation.signals import window_statistics
from probe_env.physics.simulation.simulator import STEPS_PER_CALL, Options, Simulator, advance_together
from probe_env.physics.simulation.window import Window
from probe_env.scene import Scene
from probe_env.settings import whole_steps


def groups_of(simulators: Sequence[Simulator], running: Sequence[int]) -> list[list[int]]:
    """Which of the ``running`` probes advance together: of a kind, about equally long, as many as there are lanes.

    So few that each by itself takes less time do that. All are of one method.
    """
    kinds: dict[Hashable, list[int]] = {}
    for k in sorted(running, key=lambda k: simulators[k].root):
        kinds.setdefault(simulators[k].method.kind(simulators[k].constants), []).append(k)
    groups: list[list[int]] = []
    for same in kinds.values():
        method = simulators[same[0]].method
        for start in range(0, len(same), method.width):
            group = same[start : start + method.width]
            groups += [[k] for k in group] if len(group) * method.alone_share < 1.0 else [group]
    return groups


def advance_group(members: Sequence[Simulator], steps: int, every: int) -> tuple[list[FloatArray], float]:
    """Advance probes side by side; one that diverges stops, the others go on.

    Args:
        members: the probes of a group.
        steps: to do.
        every: so many steps a sample is taken.

    Returns:
        samples (k, 2, 4) of sensor and root of each, zero from its divergence on; seconds that the kernels took.
    """
    none = np.zeros(0)
    samples = [
        Samples(every, np.array([s.sensor, -1], dtype=np.int64), np.zeros((steps // every, 2, CHANNELS)), none)
        for s in members
    ]
    seconds = 0.0
    for done in range(0, steps, STEPS_PER_CALL):
        running = [k for k, simulator in enumerate(members) if not simulator.diverged]
        if not running:
            break
        going, written = [members[k] for k in running], [samples[k] for k in running]
        seconds += advance_together(going, written, done, min(steps - done, STEPS_PER_CALL))
    return [own.rows for own in samples], seconds


class SimulatorBatch:
    """N probes that are advanced together; each equals, bit for bit, a ``Simulator`` of its own.

    Args:
        scenes: one a probe; they may differ in everything.
        method: as for ``Simulator``; "imex", "superelement" and "explicit" run four probes side by side in
            vector registers, "imex32" and "superelement32" eight; one probe by superelements, two by
            "superelement32", run each by itself.
        time_step: [s].
        nodes_per_pitch: nodes in one float pitch.
        threads: at most so many; default: the cores of this process.
        seeds: of each probe's start perturbation; default 0, 1, 2, ...
        options: of ``Simulator``, the same for all.

    ``kernel_seconds`` adds up what the kernels took, over all threads.

    Raises:
        ValueError: an argument is not valid.
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
        self.method: Final = method_named(method)
        self.simulators = [
            Simulator(scene, self.method, time_step, nodes_per_pitch, seed=seed, **options)
            for scene, seed in zip(scenes, seeds, strict=True)
        ]
        self.time_step, self.nodes_per_pitch = time_step, nodes_per_pitch
        self.kernel_seconds = 0.0
        # the two samples before a window, for differences across its start: every probe comes from rest
        self._before = [np.zeros((2, 3)) for _ in scenes]

    def __len__(self) -> int:
        return len(self.simulators)

    def __repr__(self) -> str:
        return (
            f"<SimulatorBatch of {len(self)} by {self.method.name}, step {self.time_step:g} s, {self.threads} threads>"
        )

    def snapshot(self) -> dict[str, Any]:
        """Everything that changes with time, as a copy for ``restore``, and what it belongs to."""
        probes = [s.snapshot() for s in self.simulators]
        return {"format": FORMAT, "probes": probes, "before": [before.copy() for before in self._before]}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Back to a snapshot of this batch, or of one with the same probes in the same places.

        Raises:
            ValueError: not such a snapshot; names the probe and the field. Nothing has been changed then.
        """
        saved = check_names("snapshot", check_format("snapshot", snapshot), ("format", "probes", "before"))
        for name in ("probes", "before"):
            check_types("snapshot", saved, {name: list})
            if len(saved[name]) != len(self):
                raise ValueError(f"snapshot: {len(saved[name])} {name}; here are {len(self)}")
        for k, (simulator, state, before) in enumerate(
            zip(self.simulators, saved["probes"], saved["before"], strict=True)
        ):
            simulator.checked(state, f"snapshot: probe {k}")
            check_array(f"snapshot: before[{k}]", before, (2, 3))
        for simulator, state in zip(self.simulators, saved["probes"], strict=True):
            simulator.restore(state)
        self._before = [before.copy() for before in saved["before"]]

    def __getstate__(self) -> dict[str, Any]:
        return {"format": FORMAT} | self.__dict__

    def __setstate__(self, saved: Mapping[str, Any]) -> None:
        given = dict(check_format("pickled SimulatorBatch", saved))
        del given["format"]
        self.__dict__.update(given)

    def branch(self, which: Sequence[int], scenes: Mapping[int, Scene] | None = None) -> SimulatorBatch:
        """A batch of copies of some of its probes, in their present state: what a controller tries out.

        Args:
            which: probes, each as often as copies of it are wanted.
            scenes: of probes that go on in another scene with the same mesh.

        Raises:
            ValueError: ``which`` is empty or names no probe of these, or a state does not fit its scene.
        """
        if not len(which):
            raise ValueError("which is empty: name at least one probe")
        for place, k in enumerate(which):
            if not isinstance(k, int | np.integer) or not -len(self) <= k < len(self):
                raise ValueError(f"which[{place}] = {k!r} is none of {len(self)} probes, counted from 0")
        new = copy.copy(self)
        first = {k: self.simulators[k].branch((scenes or {}).get(k)) for k in set(which)}
        new.simulators = [first[k].branch() for k in which]
        new._before = [self._before[k].copy() for k in which]
        new.kernel_seconds = 0.0
        return new

    def replace(self, index: int, simulator: Simulator) -> None:
        """Put another probe, at rest, in the place of one; it must share method, step and nodes a pitch."""
        own, other = (
            {"method": s.method.name, "time_step": s.time_step, "nodes_per_pitch": s.nodes_per_pitch}
            for s in (self, simulator)
        )
        for name, value in other.items():
            if value != own[name]:
                raise ValueError(f"{name} = {value!r} differs from the batch's {own[name]!r}")
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
        """Advance all active probes by ``duration`` towards new targets (a value, (N,) values, or None: as before).

        A probe that diverges is reported in the window and left out from then on; the others go on.

        Raises:
            ValueError: an argument is not valid, or the samples would not fit; nothing was advanced.
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
        chosen = np.ones(count, dtype=bool) if active is None else np.asarray(active, dtype=bool)
        if chosen.shape != (count,):
            raise ValueError(f"active of shape {chosen.shape}: one truth value for each of {count} probes")
        running = [k for k in range(count) if chosen[k] and not self.simulators[k].diverged]
        for k in running:  # all before any: the kernels check no bounds
            self._check_fits(k)
        check_size(steps // every + 2, count)
        for k in running:
            self.simulators[k].set_targets(speeds[k], airs[k])
        signals = np.zeros((count, steps // every + 2, 3))
        groups = groups_of(self.simulators, running)
        with ThreadPoolExecutor(self.threads) as pool:  # starts a thread with the first group that it is given
            mapped = pool.map if len(groups) > 1 else map  # to hand over to a thread waits on a busy processor
            members = ([self.simulators[k] for k in group] for group in groups)
            for group, (samples, seconds) in zip(
                groups, mapped(lambda group: advance_group(group, steps, every), members), strict=True
            ):
                self.kernel_seconds += seconds
                for k, rows in zip(group, samples, strict=True):
                    signals[k, :2], signals[k, 2:, :2], signals[k, 2:, 2] = (
                        self._before[k],
                        rows[:, 0, :2],
                        rows[:, 1, 3],
                    )
                    self._before[k] = signals[k, -2:].copy()
        return self._window(signals, running, every, keep_samples)

    def _check_fits(self, k: int) -> None:
        simulator = self.simulators[k]
        try:
            simulator.check_fits()
            check_array("before", self._before[k], (2, 3))
        except ValueError as error:
            raise ValueError(f"probe {k}: {error}") from error

    def _window(self, signals: FloatArray, running: Sequence[int], every: int, keep: bool) -> Window:
        period = every * self.time_step
        diverged = np.array([s.diverged for s in self.simulators])
        good = np.zeros(len(self), dtype=bool)
        good[list(running)] = True
        good &= ~diverged
        axial, radial, tension = (signals[good, :, field].T for field in range(3))
        statistics: dict[str, FloatArray] = {}
        for name, values in window_statistics(axial, radial, tension, period).items():
            statistics[name] = np.zeros(len(self))
            statistics[name][good] = values
        new = np.where(good[:, None, None], signals, 0.0)[:, 2:]
        return Window(
            statistics=statistics,
            inserted_length=np.array([s.inserted_length for s in self.simulators]),
            feed_speed=np.array([s.feed_speed for s in self.simulators]),
            air_supply_rate=np.array([s.air_supply_rate for s in self.simulators]),
            diverged=diverged,
            time=period * np.arange(1, new.shape[1] + 1) if keep else None,
            axial=new[:, :, 0].T.copy() if keep else None,
            radial=new[:, :, 1].T.copy() if keep else None,
            tension=new[:, :, 2].T.copy() if keep else None,
        )


def _targets(value: FloatArray | float | None, count: int) -> list[float | None]:
    if value is None:
        return [None] * count
    values = np.broadcast_to(np.asarray(value, dtype=float), (count,))
    return [float(v) for v in values]
