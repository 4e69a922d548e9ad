"""Slow motion of the unrolled tube near the tip: walls, floats, contacts, cable and signals of the sensor.

A control period stores the motion of the sensor only. For the other nodes a copy of the simulator advances by the
period towards its targets, bit for bit as the probe.
"""

import copy
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.pictures.plate import (
    DPI,
    GREEN,
    ORANGE,
    QUIET_MM,
    RED,
    SIZE,
    Picture,
    Plate,
    label_of,
    limits_around,
)  # fmt: skip
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.simulator import Simulator
from probe_env.scene import Scene

FRAME_PERIOD: Final = 5e-3
"""Time of the dynamics between two frames [s]."""
EVERY: Final = round(FRAME_PERIOD / SAMPLE_PERIOD)


@dataclass(frozen=True)
class Motion:
    """The n nodes nearest to the tip at k times on the dynamics clock; the tip first."""

    scene: Scene
    sensor: int  # node of the sensor
    distance: FloatArray  # (n,) unstretched distance from the tip [m]
    lever: FloatArray  # (n,) float radius [m]
    outer_gap: FloatArray  # (n,) radial displacement at contact with the outer wall [m]; infinite without that wall
    floats: BoolArray  # (n,) whether the node is a float
    time: FloatArray  # (k,) since the first frame, ``FRAME_PERIOD`` apart [s]
    inserted_length: FloatArray  # (k,) [m], linear within a control period
    axial: FloatArray
    radial: FloatArray  # (k, n) displacement [m]; radial 0 touches the inner wall, negative presses on it
    signal_time: FloatArray  # (m,) of the signals, ``SAMPLE_PERIOD`` apart [s]; negative before the first frame
    signal_axial: FloatArray
    signal_radial: FloatArray  # (m,) displacement of the sensor [m]

    @property
    def on_inner_wall(self) -> BoolArray:
        """(k, n) floats that press on the inner wall, the contact of the model."""
        return self.floats & (self.radial < 0.0)

    @property
    def on_outer_wall(self) -> BoolArray:
        """(k, n) floats that press on the outer wall."""
        return self.floats & (self.radial > self.outer_gap)


class Watch:
    """Records the motion of a probe near its tip, now and then every ``FRAME_PERIOD``.

    Args:
        simulator: the probe now; its time step divides ``SAMPLE_PERIOD``.
        length: recorded length from the tip [m]: at least to the sensor, at most the inserted length.
        axial, radial: (m,) previous signals of the sensor, ``SAMPLE_PERIOD`` apart [m].
    """

    def __init__(self, simulator: Simulator, length: float, axial: FloatArray, radial: FloatArray) -> None:
        h = simulator.chain.element_length
        self._scene, self._sensor, self._chain = simulator.scene, simulator.sensor, simulator.chain
        self._nodes = np.arange(min(max(round(length / h), simulator.sensor), simulator.root - 1) + 1)
        self._before, self._samples = len(axial), 0
        self._axial, self._radial = [axial], [radial]
        self._shapes, self._lengths = (
            [simulator.state.d[None, self._nodes, :2]],
            [np.array([simulator.length_in_helix])],
        )

    def follow(self, simulator: Simulator, feed_speed: float, air_supply_rate: float, duration: float) -> Simulator:
        """Record a copy of the probe for ``duration`` [s] towards targets [m/s], [m3/s].

        Returns:
            the copy at the end.

        Raises:
            ValueError: the duration is no whole number of time steps, or a target is out of range.
            SimulationError: the state diverges.
        """
        ahead, points = copy.deepcopy(simulator), (self._chain.element_length * self._nodes).tolist()
        run = ahead.advance(feed_speed, air_supply_rate, duration, SAMPLE_PERIOD, points)
        self._axial.append(run.axial[1:, self._sensor])
        self._radial.append(run.radial[1:, self._sensor])
        frames = slice(EVERY - self._samples % EVERY, None, EVERY)
        self._samples += len(run.time) - 1
        self._shapes.append(np.stack([run.axial[frames], run.radial[frames]], axis=-1))
        lengths = simulator.length_in_helix, ahead.length_in_helix
        self._lengths.append(np.interp(run.time[frames], run.time[[0, -1]], lengths))
        return ahead

    def motion(self) -> Motion:
        """Motion recorded so far."""
        chain, nodes = self._chain, self._nodes
        axial, radial = np.concatenate(self._axial), np.concatenate(self._radial)
        shapes, lengths = np.concatenate(self._shapes), np.concatenate(self._lengths)
        return Motion(
            scene=self._scene,
            sensor=self._sensor,
            distance=nodes * chain.element_length,
            lever=chain.lever[nodes],
            outer_gap=chain.outer_gap[nodes],
            floats=chain.contact_stiffness[nodes] > 0.0,
            time=FRAME_PERIOD * np.arange(len(lengths)),
            inserted_length=lengths,
            axial=shapes[:, :, 0],
            radial=shapes[:, :, 1],
            signal_time=SAMPLE_PERIOD * (np.arange(len(axial)) + 1 - self._before),
            signal_axial=axial,
            signal_radial=radial,
        )


FRAMES_PER_SECOND: Final = 25
SLOWED: Final = 1.0 / (FRAMES_PER_SECOND * FRAME_PERIOD)
"""Slow-motion factor."""
AXIAL: Final = 50.0
"""Exaggeration of the axial displacement, which is less than a pixel to scale."""
TRACE_SECONDS: Final = 0.5
"""Duration of the signals in a picture [s]."""
AHEAD: Final = 0.04
"""Margin before the tip and after the last node, relative to the length."""
BESIDE: Final = 0.12
"""Margin beyond each wall, relative to the bore."""
MARKED: Final = 0.05
"""Distance of contact marks from their wall, relative to the bore."""
FREE: Final = "#9bb8d9"
"""Colour of a float without contact."""


class Strip:
    """Pictures of a motion near the tip of a probe; the inner wall is at the bottom, insertion is to the right.

    Args:
        motion: the motion.
        policy: name of the policy, for the title.

    Attributes:
        axial_scale, radial_scale: scale of the drawing [pixels/m].
    """

    def __init__(self, motion: Motion, policy: str) -> None:
        self.motion = motion
        figure = Figure(figsize=SIZE, dpi=DPI)
        self._tube = figure.add_axes((0.075, 0.44, 0.91, 0.41))
        self._signals = [figure.add_axes((0.075, bottom, 0.91, 0.11)) for bottom in (0.235, 0.09)]
        self._draw_tube()
        self._draw_signals()
        size = self._tube.get_window_extent()
        (left, right), (low, high) = self._tube.get_xlim(), self._tube.get_ylim()
        self.axial_scale, self.radial_scale = size.width / (right - left), 1e3 * size.height / (high - low)
        title = f"The last {motion.distance[-1]:g} m behind the tip, unrolled, slowed down {SLOWED:g} times"
        figure.text(0.075, 0.955, title, fontsize=11)
        figure.text(0.985, 0.955, f"{policy}; {label_of(motion.scene)}", fontsize=8, color="0.35", ha="right")
        scale = (
            f"radial direction stretched x {self.radial_scale / self.axial_scale:.0f},"
            f" axial displacement drawn x {AXIAL:g}"
        )
        figure.text(0.985, 0.915, scale, fontsize=8, color="0.35", ha="right")
        self._now = figure.text(0.075, 0.915, "", fontsize=9)
        moving = (self._floats, self._cable, *self._contacts, self._sensor, *self._lines, self._now)
        self._plate = Plate(figure, moving)

    def picture(self, k: int) -> Picture:
        """(h, w, 3) RGB picture of frame ``k``."""
        motion, edge = self.motion, self.edge(k)
        centre = edge + [0.0, 1e3] * np.column_stack([np.zeros_like(motion.lever), motion.lever])
        self._cable.set_data(*centre.T)
        floats = motion.floats
        top = edge[floats] + np.column_stack([np.zeros(floats.sum()), 2e3 * motion.lever[floats]])
        self._floats.set_segments(list(np.stack([edge[floats], top], axis=1)))
        self._floats.set_color(self._colours(k))
        bore = motion.scene.tube.inner_diameter * 1e3
        walls = ((motion.on_inner_wall, -MARKED * bore), (motion.on_outer_wall, (1.0 + MARKED) * bore))
        for marks, (touching, height) in zip(self._contacts, walls, strict=True):
            where = edge[touching[k], 0]
            marks.set_data(where, np.full(len(where), height))
        self._sensor.set_data(*centre[motion.sensor][:, None])
        time = motion.signal_time - motion.time[k]
        visible = (time > -TRACE_SECONDS - SAMPLE_PERIOD) & (time < 0.5 * SAMPLE_PERIOD)
        for line, values in zip(self._lines, (motion.signal_radial, motion.signal_axial), strict=True):
            line.set_data(time[visible], values[visible] * 1e3)
        self._now.set_text(f"{motion.inserted_length[k]:.2f} m inserted, {motion.time[k]:.3f} s")
        return self._plate.picture()

    def edge(self, k: int) -> FloatArray:
        """(n, 2) position along the tube [m], the unstretched tip at 0, and edge nearest to the inner wall [mm]."""
        motion = self.motion
        return np.column_stack([AXIAL * motion.axial[k] - motion.distance, 1e3 * motion.radial[k]])

    def _colours(self, k: int) -> list[str]:
        """Colours of the floats: free, on the inner wall, on the outer wall."""
        inner, outer = (
            flags[k, self.motion.floats] for flags in (self.motion.on_inner_wall, self.motion.on_outer_wall)
        )
        return [RED if i else ORANGE if o else FREE for i, o in zip(inner, outer, strict=True)]

    def _draw_tube(self) -> None:
        motion, axes = self.motion, self._tube
        bore, length = motion.scene.tube.inner_diameter * 1e3, float(motion.distance[-1])
        room = AHEAD * length + AXIAL * float(np.abs(motion.axial).max())
        axes.set(xlim=(-length - room, room), ylim=(-BESIDE * bore, (1.0 + BESIDE) * bore))
        axes.set_xlabel("from the tip [m]", fontsize=8)
        axes.set_ylabel("from the inner wall [mm]", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.axhline(0.0, color="black", linewidth=1.5)
        modelled = bool(np.isfinite(motion.outer_gap).all())
        axes.axhline(bore, color="black", linewidth=1.5, linestyle="-" if modelled else ":")
        (self._cable,) = axes.plot([], [], color="0.25", linewidth=1.2)
        self._floats = LineCollection([], linewidths=self._float_width(), capstyle="butt")
        axes.add_collection(self._floats)
        self._contacts = [axes.plot([], [], m, color=c, markersize=3)[0] for m, c in (("^", RED), ("v", ORANGE))]
        (self._sensor,) = axes.plot([], [], "o", color=GREEN, markersize=8, markeredgecolor="white")
        for colour, name in ((FREE, "float"), (RED, "on the inner wall"), (ORANGE, "on the outer wall")):
            axes.plot([], [], color=colour, linewidth=4, label=name)
        axes.plot([], [], "o", color=GREEN, markersize=6, label="sensor")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, fontsize=8, borderpad=0.1)

    def _float_width(self) -> float:
        """Line width [points] of 0.4 pitches; the model has no length of floats."""
        low, high = self._tube.get_xlim()
        pitch = self.motion.scene.probe.float_pitch / (high - low) * self._tube.get_window_extent().width
        return float(0.4 * pitch * 72.0 / DPI)

    def _draw_signals(self) -> None:
        motion = self.motion
        self._lines = []
        signals = ((motion.signal_radial, "radial"), (motion.signal_axial, "axial"))
        for axes, (values, name) in zip(self._signals, signals, strict=True):
            axes.set(xlim=(-TRACE_SECONDS, 0.0), ylim=limits_around(values * 1e3, (0.0, QUIET_MM)))
            axes.set_ylabel(f"sensor,\n{name} [mm]", fontsize=8)
            axes.yaxis.set_label_coords(-0.04, 0.5)
            axes.tick_params(labelsize=7, labelbottom=axes is self._signals[-1])
            axes.grid(color="0.92")
            self._lines += axes.plot([], [], color=GREEN, linewidth=1.0)
        self._signals[-1].set_xlabel("time before this picture [s]", fontsize=8)
