"""Films of an episode, or of the motion near the tip in slow motion."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import gymnasium as gym
import imageio.v3 as iio
import numpy as np
import numpy.typing as npt
from PIL import Image
from tqdm import tqdm

import probe_env
from probe_agents.policies.catalogue import make_policy
from probe_agents.records.atomic import write_atomically
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.pictures.strip import FRAME_PERIOD, SLOWED, Motion, Strip, Watch
from probe_env.envs.pictures.strip import FRAMES_PER_SECOND as SLOW_FRAMES_PER_SECOND
from probe_env.envs.task.config import VISIBLE_FIELDS
from probe_env.physics.simulation.signals import SAMPLE_PERIOD, dominant_frequencies
from probe_env.settings import whole_steps, within

FRAMES_PER_SECOND: Final = 10
MAX_DURATION: Final = 2.0
"""Maximum duration in slow motion [s]: 400 pictures."""
FARTHEST: Final = 1000.0
"""Maximum distance behind the tip [m]."""
RESOLVED: Final = 0.5
"""Minimum duration for an estimate of a frequency [s]: down to 2 Hz."""
STRIP_START: Final = 0.75
"""Share of the helix at which slow motion begins by default."""
FORMATS: Final = (".gif", ".mp4", ".png")
COLOURS: Final = 255
"""Colours of a GIF; all pictures have the same palette."""


class _Episode:
    """An episode of an environment under a policy (by its spec, see ``catalogue``)."""

    def __init__(self, env_id: str, policy: str, **arguments: Any) -> None:
        assert probe_env.__all__  # the import registers the ids
        self.env: Any = gym.make(env_id, config=dict.fromkeys(VISIBLE_FIELDS, True), **arguments)
        self.episodes: Episodes = self.env.get_wrapper_attr("episodes")
        self.episodes.allow_standstill = True  # as in an evaluation
        self._policy = make_policy(policy, self.episodes.config, classes=True)
        self._state: Any = None
        self._start = np.ones(1, dtype=bool)
        self.ended, self.info = False, dict[str, Any]()

    def reset(self, seed: int) -> None:
        """Reset the environment."""
        self._observation, self.info = self.env.reset(seed=seed)

    def next_action(self) -> npt.NDArray[np.float32]:
        """Action (2,) of the policy for the next period."""
        observation = self._observation[None]
        action, self._state = self._policy.predict(observation, self._state, self._start, deterministic=True)
        self._start = np.zeros(1, dtype=bool)
        return np.asarray(action[0], dtype=np.float32)

    def step(self, action: npt.NDArray[np.float32]) -> None:
        """Apply an action for a control period."""
        self._observation, _, terminated, truncated, self.info = self.env.step(action)
        self.ended = terminated or truncated


def render_episode(env_id: str, output: Path, policy: str, every: int, seed: int, **arguments: Any) -> dict[str, float]:
    """Film an episode, one frame every ``every`` control periods; returns its KPIs without the detection curve."""
    check_format(output)
    if every < 1:
        raise ValueError(f"every = {every!r} is outside the accepted range 1 and more")
    episode, steps = _Episode(env_id, policy, render_mode="rgb_array", **arguments), 0
    episode.reset(seed)
    animated = output.suffix != ".png"
    frames: list[Any] = [episode.env.render()] if animated else []
    with tqdm(desc=f"{env_id}", unit="period") as bar:
        while not episode.ended:
            episode.step(episode.next_action())
            steps += 1
            if (animated and steps % every == 0) or episode.ended:
                frames.append(episode.env.render())
            bar.update()
    episode.env.close()
    _write_film(output, frames, FRAMES_PER_SECOND)
    return {name: value for name, value in episode.info["episode_kpis"].items() if not name.startswith("pod")}


def render_strip(
    env_id: str,
    output: Path,
    policy: str,
    seed: int,
    at: float | None = None,
    length: float = 10.0,
    duration: float = 0.5,
    **arguments: Any,
) -> dict[str, float]:
    """Film the motion near the tip in slow motion, from an inserted length that a policy has reached.

    Args:
        env_id: id of the environment.
        output: file of the film.
        policy: spec of the policy.
        seed: seed of the tube and the sensor noise.
        at: inserted length at the start [m]; None: three quarters of the helix; with constant length: the start.
        length: length of the strip behind the tip [m], at least to the sensor.
        duration: simulated duration [s], a whole number of milliseconds.
        arguments: further arguments of the environment.

    Returns:
        figures of the motion, SI units.

    Raises:
        SimulationError: the state diverged in the film.
    """
    check_format(output)
    episode = _Episode(env_id, policy, **arguments)
    simulator = episode.episodes.simulated().simulators[0]  # before the reset
    start, end = simulator.inserted_length, simulator.scene.tube.helix_length
    within("length", length, simulator.scene.probe.guide_length, FARTHEST, "m")  # includes the sensor
    within("duration", duration, FRAME_PERIOD, MAX_DURATION, "s")
    whole_steps("duration", duration, SAMPLE_PERIOD)
    if not episode.episodes.config.growing:
        if at is not None:
            raise ValueError(f"at = {at!r} m needs a growing insertion; in this environment the length is {start:g} m")
        at = start
    at = STRIP_START * end if at is None else at
    if episode.episodes.config.growing and not start <= at < end:
        raise ValueError(f"at = {at!r} m is outside the accepted range {start:g} m (the start) to less than {end:g} m")
    episode.reset(seed)
    motion = _motion(episode, at, length, duration)
    strip = Strip(motion, Path(policy).stem)
    frames = range(len(motion.time)) if output.suffix != ".png" else [len(motion.time) - 1]
    _write_film(output, [strip.picture(k) for k in tqdm(frames, desc="pictures", unit="")], SLOW_FRAMES_PER_SECOND)
    figures = {"inserted_length_m": float(motion.inserted_length[0]), "shown_s": float(motion.time[-1])}
    figures["times_slowed"] = SLOWED
    for name, values in (("axial", motion.signal_axial), ("radial", motion.signal_radial)):
        during = values[motion.signal_time >= 0.0]
        figures[f"sensor_{name}_rms_m"] = float(during.std())
        peaks = dominant_frequencies(during, SAMPLE_PERIOD, 1) if motion.time[-1] >= RESOLVED else ()
        figures |= {f"sensor_{name}_peak_hz": frequency for frequency in peaks}
    return figures


def _motion(episode: _Episode, at: float, length: float, duration: float) -> Motion:
    episodes = episode.episodes
    with tqdm(desc="feeding", unit="period") as bar:
        while episode.info["inserted_length"] < at and not episode.ended:
            episode.step(episode.next_action())
            bar.update()
    if episode.ended:
        info = episode.info
        reasons = (", lost drive" if info["lost_drive"] else "") + (", diverged" if info["diverged"] else "")
        raise ValueError(
            f"at = {at:g} m was not reached: the episode ended at {info['inserted_length']:.4g} m{reasons}"
        )
    axial: FloatArray = np.zeros(0)
    radial: FloatArray = np.zeros(0)
    window = episodes.window
    if window and window.axial is not None and window.radial is not None:
        axial, radial = window.axial[:, 0], window.radial[:, 0]
    simulated, remaining = episodes.simulated(), duration
    watch = Watch(simulated.simulators[0], length, axial, radial)
    while remaining > 0.5 * SAMPLE_PERIOD and not episode.ended:
        action = episode.next_action()
        targets = episodes.targets(action[None])
        period = episodes.config.period / simulated.time_lapse(targets, episodes.direction)[0]  # of the dynamics
        feed_speed, air_supply_rate = targets[0]
        watch.follow(simulated.simulators[0], feed_speed, air_supply_rate, min(remaining, period))
        episode.step(action)
        remaining -= period
    return watch.motion()


def check_format(output: Path) -> None:
    """Raise ValueError unless a film can be written under this name."""
    if output.suffix not in FORMATS:
        raise ValueError(f"output = {str(output)!r} must end in one of {', '.join(FORMATS)}")


def _write_film(output: Path, frames: Sequence[Any], frames_per_second: int) -> None:
    """Write RGB pictures (h, w, 3) as a film (.gif, .mp4), or the last of them (.png), atomically."""
    if output.suffix == ".gif":
        film = _gif(frames, frames_per_second)
    elif output.suffix == ".png":
        film = iio.imwrite("<bytes>", frames[-1], extension=".png")
    else:
        options: dict[str, Any] = {"fps": frames_per_second, "codec": "libx264", "macro_block_size": 8}
        film = iio.imwrite("<bytes>", list(frames), extension=output.suffix, **options)
    write_atomically(output, film)


def _gif(frames: Sequence[Any], frames_per_second: int) -> bytes:
    some = np.concatenate([frames[0], frames[len(frames) // 2], frames[-1]])
    plain = Image.Dither.NONE  # dots would flicker
    palette = Image.fromarray(some).quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=plain)
    first, *others = (Image.fromarray(frame).quantize(palette=palette, dither=plain) for frame in frames)
    buffer = io.BytesIO()
    first.save(
        buffer, "GIF", save_all=True, append_images=others, duration=1000 // frames_per_second, loop=0, optimize=False
    )
    return buffer.getvalue()
