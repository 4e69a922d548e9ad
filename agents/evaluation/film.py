"""A film of an episode, as GIF or MP4, or its last picture as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v3 as iio
import numpy as np
from tqdm import tqdm

import probe_env
from agents.policies.catalogue import make_policy
from agents.records.atomic import write_atomically
from probe_env.envs.task import SHOWN

FORMATS = (".gif", ".mp4", ".png")
FRAMES_PER_SECOND = 10


def render_episode(env_id: str, output: Path, policy: str, every: int, seed: int, **arguments: Any) -> dict[str, float]:
    """Film an episode under a policy (by its spec, see ``catalogue``), a frame every so many control periods.

    Returns:
        the episode's KPIs.

    Raises:
        ValueError: an argument is not valid; nothing was written.
    """
    assert probe_env.__all__  # imported for its ids
    if output.suffix not in FORMATS:
        raise ValueError(f"output = {str(output)!r} must end in one of {', '.join(FORMATS)}")
    if every < 1:
        raise ValueError(f"every = {every!r} is outside the accepted range 1 and more")
    env = gym.make(env_id, render_mode="rgb_array", config=dict.fromkeys(SHOWN, True), **arguments)
    controller = make_policy(policy, env.unwrapped.config)  # type: ignore[attr-defined]
    observation, _ = env.reset(seed=seed)
    state, start = None, np.ones(1, dtype=bool)
    frames: list[Any] = [env.render()]
    steps, ended, info = 0, False, dict[str, Any]()
    with tqdm(desc=f"{env_id}", unit="period") as bar:
        while not ended:
            action, state = controller.predict(observation[None], state, start, deterministic=True)
            start = np.zeros(1, dtype=bool)
            observation, _, terminated, truncated, info = env.step(action[0])
            ended, steps = terminated or truncated, steps + 1
            if steps % every == 0 or ended:
                frames.append(env.render())
            bar.update()
    env.close()
    write_atomically(output, _film(frames, output.suffix))
    kpis: dict[str, float] = info["episode_kpis"]
    return kpis


def _film(frames: list[Any], suffix: str) -> bytes:
    """The frames as a file of a format, or the last of them."""
    if suffix == ".png":
        return iio.imwrite("<bytes>", frames[-1], extension=suffix)
    if suffix == ".gif":
        return iio.imwrite("<bytes>", frames, extension=suffix, duration=1000 / FRAMES_PER_SECOND, loop=0)
    return iio.imwrite("<bytes>", frames, extension=suffix, fps=FRAMES_PER_SECOND, codec="libx264", macro_block_size=8)
