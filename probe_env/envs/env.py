"""The Gymnasium environments: glue around ``Episodes`` with one probe, or with N in one batch for ``make_vec``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, SupportsFloat, Unpack

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from probe_env.arrays import FloatArray
from probe_env.envs.episodes.starts import DEFAULTS, EpisodeSettings, placed
from probe_env.envs.surrogate import make_episodes
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import is_surrogate
from probe_env.settings import in_one_line

if TYPE_CHECKING:
    from probe_env.envs.pictures.episode import Renderer

Observation = npt.NDArray[np.float32]
RENDER_MODES = ("rgb_array", "human")


def spaces_of(config: TaskConfig) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Observation and action space of a task."""
    low, high = np.array([bounds[:2] for bounds in config.observations.values()], dtype=np.float32).T
    return gym.spaces.Box(low, high, dtype=np.float32), gym.spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)


def check_episode_steps(steps: int | None) -> None:
    """Raise ValueError if an episode could never take its first step."""
    if steps is not None and steps < 1:
        raise ValueError(f"max_episode_steps = {steps!r} is outside the accepted range 1 and more")


class ProbeEnv(gym.Env[Observation, Observation]):
    """Base of the environments with one probe, see ``InsertionEnv`` for the arguments."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # type: ignore[misc]
    defaults: ClassVar[dict[str, Any]] = {}

    @in_one_line()
    def __init__(
        self,
        config: TaskConfig | Mapping[str, Any] | None = None,
        *,
        render_mode: str | None = None,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(f"render_mode = {render_mode!r} is not one of {', '.join(RENDER_MODES)}")
        if render_mode is not None and is_surrogate(settings.get("fidelity", DEFAULTS["fidelity"])):
            raise ValueError(f"render_mode = {render_mode!r}: fidelity 'surrogate' simulates no motion to draw")
        self.config, settings = placed(self.defaults, config, settings)
        self.episodes = make_episodes(1, self.config, threads=1, **settings)
        self.observation_space, self.action_space = spaces_of(self.config)  # type: ignore[assignment]
        self.render_mode = render_mode
        self._renderer: Renderer | None = None

    @in_one_line()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see ``Episodes.reset`` for the options."""
        super().reset(seed=seed)
        observation, infos = self.episodes.reset([0], {0: self.np_random}, {0: options})
        if self.render_mode is not None:
            from probe_env.envs.pictures.episode import Renderer  # and with it matplotlib

            self._renderer = self._renderer or Renderer(self.episodes)
            self._renderer.begin(infos[0])
            if self.render_mode == "human":
                self.render()
        return observation[0], infos[0]

    def step(self, action: Observation) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """One control period with a target of feed speed and air supply."""
        step = self.episodes.step(np.asarray(action)[None])
        reward = float(step.reward[0])
        if self._renderer is not None:
            self._renderer.add(step.infos[0], reward)
            if self.render_mode == "human":
                self.render()
        return step.observation[0], reward, bool(step.terminated[0]), bool(step.truncated[0]), step.infos[0]

    def render(self) -> npt.NDArray[np.uint8] | None:
        """An RGB picture (h, w, 3) of the present period; with "human" it is shown in a window instead."""
        if self.render_mode is None:
            gym.logger.warn("render was called without a render_mode: give render_mode='rgb_array' or 'human'")
            return None
        if self._renderer is None:
            raise RuntimeError("nothing to render: call reset first")
        if self.render_mode == "human":
            self._renderer.show()
            return None
        return self._renderer.picture()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class InsertionEnv(ProbeEnv):
    """Feed a probe into the helix: fast while it is free, slowly where it rings.

    ## Description
    A cable with floats is fed into a helical tube, pulled by an air stream and held back by the feed. Above some
    inserted length it rings and buries the signal in noise. How soon depends on friction and drag, which the
    controller is not told. One episode feeds the probe from 5 m (or its guide length + 2.5 m) to the end of the
    helix at 60 m.

    ## Action Space
    `Box(-1, 1, (2,), float32)`, mapped linearly:

    | Num | Action | Min | Max | Unit |
    |---|---|---|---|---|
    | 0 | target feed speed; the feed ramps at 0.5 m/s2 | 0.02 | 0.4 | m/s |
    | 1 | target air supply; follows with a lag of 1 s | 30 | 130 | m3/h |

    ## Observation Space
    A `Box` of float32; names, bounds and meaning in `probe_env.envs.task.scales.OBSERVATIONS`:

    | Num | Observation | Scale |
    |---|---|---|
    | 0, 1 | inserted and remaining length | 60 m |
    | 2, 3 | applied feed speed, applied air supply | 0.4 m/s, 130 m3/h |
    | 4, 5 | radial and axial accelerometer, rms | log10, 1 m/s2 |
    | 6 | eddy-current noise, proportional to the radial rms (5 % sensor noise) | log10, 0.1 mm |
    | 7 | mean root tension (2 % sensor noise; the load cell ends at 10 kN) | 20 N |
    | 8, 9 | previous action | - |
    | 10 | helix diameter | 2.5 m |

    Friction and contact stiffness are not observed. `config={"observe_root_tension": False}` leaves out 7,
    `{"privileged": True}` adds friction, contact stiffness and drag; `{"observe_probe": True}` the seven figures of the
    probe that was built (`probe_env.envs.task.scales.PROBE`), for one controller of many probes.

    ## Rewards
    The sum of `info["reward_terms"]`: progress (1 per metre), vibration (-(rms / 0.1 mm)^2 per metre, the ratio up
    to 3), time (-0.1 per second), air (-0.2 per m3), jerk (-0.005 times the squared change of the action),
    uninspected (per metre that was not inspected when the episode ends, the most that inspecting one can cost),
    diverged (-10). Weights are fields of `probe_env.envs.task.TaskConfig`.

    Beside it, and in no reward, `info["cost"]` counts what is unsafe in the period, the sum of `info["cost_terms"]`,
    each 0 or 1: lost_drive (tension too low to drive, see Episode End), tension (above `tension_limit`, 110 N unless
    changed), buckling (the root is pressed with more than the cable bears between two floats).

    ## Starting State
    A context is drawn (friction 0.10-0.25, contact stiffness 0.7e5-1.4e5 N/m, drag +-10 %, one of six helix
    diameters); the probe settles for 2 s at 0.2 m/s and 63 m3/h. `options` of `reset` fix any of these. A context that
    the fidelity's step or the model cannot simulate is a `ValueError` that names it, see
    `probe_env.envs.episodes.limits`.

    ## Episode End
    Terminated at the end of the helix, on lost drive (mean root tension below 0.8 N, an assumption for the rising
    straight part, in 3 periods in a row once 15 m are in) and when the simulation diverges
    (`info["diverged"]`, with the last finite observation); truncated after 900 s.
    `info["episode_kpis"]` then has the figures of the episode.

    ## Arguments
    * `config`: fields of `TaskConfig` to change, or a whole one.
    * `tube`: a plant of one's own, the path of its `tube.toml`, its fields as a mapping or a `probe_env.Plant`: sets
      the scene, the task's ranges and limits, and what is known of friction, stiffness and drag, from which random
      contexts are drawn. `config` then changes fields of its task.
    * `scene`: what contexts and options change, without a tube; default table 2 of the study. A `Scene`, or a mapping
      of what differs from it, such as `{"tube": {"inner_diameter": 0.025}}`, with which `spec.to_json()` works.
    * `fidelity`: "standard", "fast", another preset, "auto" or custom settings, see `probe_env.fidelity`. "surrogate"
      predicts from a vibration map instead of simulating, some 100 times faster, for training; without a render mode.
    * `surrogate_map`: the map's file, for "surrogate" alone; default: NAME-map.npz beside the `tube`'s file, if there
      is one, else that of table 2's tubes.
    * `contexts`: "random", a shipped list ("train", "validation", "test"), `Context`s or mappings of one's own, or
      `Ranges` to draw from.
    * `feed_speed`, `air_supply_rate`: of the settling, SI units; default 0.2 m/s and 63 m3/h, or the nearest in range.
    * `probes`: "scene", or "random": every reset draws a `probe_env.Design` from the whole design space, so that one
      agent serves many probes; it shows in the reset's `info["probe"]` and, with `config={"observe_probe": True}`, in
      the observation; a constant length is cut to whole pitches.
    * `render_mode`: "rgb_array" or "human".
    """


class SnapshotEnv(ProbeEnv):
    """A probe of constant length, as in the study's figures: for quick tests and comparison.

    ## Description
    As `Insertion-v1`, but the length stays as it is (carrier length of the scene, 50 m, or the option
    `carrier_length`): what is fed in counts as inspected and does not lengthen the probe. Control period 0.1 s,
    truncated after 8 s; the probe starts from rest and settles for one period.

    Actions, observations, rewards and arguments are those of `Insertion-v1`; nothing is left uninspected.

    ## Starting State
    At rest, then one period at the settling's feed and air.

    ## Episode End
    Truncated after 8 s; terminated on lost drive and when the simulation diverges.
    """

    defaults: ClassVar[dict[str, Any]] = {"growing": False, "period": 0.1, "time_limit": 8.0, "settle_time": 0.1}


class InspectionEnv(ProbeEnv):
    """A whole inspection: feed a probe in and draw it back, looking both ways.

    ## Description
    The probe is fed in as in `Insertion-v1`. At the end of the helix feed and air are turned round: the air blows
    towards the feed device, which draws the cable out, until the probe is where it began. On withdrawal the cable is
    pressed and lies on the outer wall, where it hardly rings. What a metre counts for is the better of both passes.

    ## Action Space
    As `Insertion-v1`: how fast and how much air, of the pass that the probe is on.

    ## Observation Space
    As `Insertion-v1`; feed speed and air supply are below 0 on withdrawal, and `way` comes before what is privileged:
    1 on insertion, -1 on withdrawal.

    ## Rewards
    As `Insertion-v1`, for time and air of both passes. `config={"inspects": "best"}` (default): a metre that is quieter
    on withdrawal than on insertion gives the difference back; `"in"`: withdrawal shows nothing; `"back"`: nothing
    but withdrawal counts as inspected. KPIs of what is found go by the same: with `"best"` a flaw is found where
    either pass calls it, each with half of the false calls. Whatever counts, uninspected is what is left of both passes
    when the episode ends: a probe that stays in the tube owes the metres that it was not drawn back.

    ## Episode End
    Terminated when the probe is back where it began, on lost drive on insertion, and when the simulation diverges;
    truncated after 1,800 s.

    ## Arguments
    As `Insertion-v1`. `fidelity`: "standard" and "fast" simulate withdrawal, with nodes between the
    floats; so do settings with newmark, wilson, imex, implicit or explicit. Time-lapse ("fast") is for insertion
    alone: on withdrawal the motion is what the turn or a change of the feed has left. The cable touches the walls in
    every scene.
    """

    defaults: ClassVar[dict[str, Any]] = {"passes": "both", "time_limit": 1800.0}


class ProbeVectorEnv(gym.vector.VectorEnv[Observation, Observation, Any]):
    """N environments in one batch; each equals a single environment with the seed ``seed + i`` bit for bit.

    Args:
        num_envs: N.
        autoreset_mode: when an ended episode starts anew: ``AutoresetMode.NEXT_STEP`` (default), ``SAME_STEP``
            (with ``final_obs`` and ``final_info`` in the infos) or ``DISABLED`` (``options["reset_mask"]``).
        threads: at most so many; default: all cores.
        config, settings: see ``InsertionEnv``.
        max_episode_steps: an episode is truncated after so many steps, as by ``gymnasium.make``; default: only by the
            task's own time limit, a field of ``config``.
        render_mode: refused: render a single environment.

    Raises:
        ValueError: an argument is not valid.
    """

    single: ClassVar[type[ProbeEnv]] = ProbeEnv

    @in_one_line()
    def __init__(
        self,
        num_envs: int = 1,
        config: TaskConfig | Mapping[str, Any] | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        check_episode_steps(max_episode_steps)
        if render_mode is not None:
            raise ValueError(f"render_mode = {render_mode!r}: a batch is not rendered; use a single environment")
        self.config, settings = placed(self.single.defaults, config, settings)
        self.episodes = make_episodes(num_envs, self.config, threads=threads, **settings)
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = self.single.metadata | {"autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = spaces_of(self.config)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs: dict[int, np.random.Generator] = {}
        self._ended = np.zeros(num_envs, dtype=bool)
        self.max_episode_steps, self._steps = max_episode_steps, np.zeros(num_envs, dtype=int)

    @in_one_line()
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes: all, or those of ``options["reset_mask"]``. Other options are those of the single one.

        Raises:
            ValueError: seeds, mask or options are not valid.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"options['reset_mask'] must be {self.num_envs} booleans, at least one of them true")
        which = np.flatnonzero(mask).tolist()
        seeds = [seed + k for k in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries for {self.num_envs} environments")
        for k in which:
            own_seed = None if seeds is None else seeds[k]
            if own_seed is not None or k not in self._rngs:  # else its generator goes on
                self._rngs[k] = gym.utils.seeding.np_random(own_seed)[0]
        observation, infos = self.episodes.reset(which, self._rngs, dict.fromkeys(which, options))
        self._ended[mask], self._steps[mask] = False, 0
        merged: dict[str, Any] = {}
        for k in which:
            merged = self._add_info(merged, infos[k], k)
        return observation, merged

    def step(
        self, actions: npt.ArrayLike
    ) -> tuple[Observation, FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """One control period; ended episodes are handled after ``autoreset_mode``."""
        starting = self._ended.copy()
        if starting.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(f"episode {np.flatnonzero(starting)[0]} has ended: reset it with options['reset_mask']")
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        reward: FloatArray = np.zeros(self.num_envs)
        terminated, truncated = np.zeros_like(starting), np.zeros_like(starting)
        observation = self.episodes.observation.copy()
        if not starting.all():
            step = self.episodes.step(actions, ~starting)
            observation, reward, terminated, truncated = step.observation, step.reward, step.terminated, step.truncated
            infos = step.infos
            self._steps += ~starting
            if self.max_episode_steps is not None:
                truncated = truncated | (~starting & (self._steps >= self.max_episode_steps))
        if starting.any():  # NEXT_STEP: this step is their reset
            observation, started = self._start(np.flatnonzero(starting).tolist())
            for k, info in started.items():
                infos[k] = info
        self._ended = terminated | truncated
        if self._ended.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
            ended = np.flatnonzero(self._ended).tolist()
            final = observation.copy()
            observation, started = self._start(ended)
            for k in ended:
                infos[k] = started[k] | {"final_obs": final[k], "final_info": infos[k]}
            self._ended[:] = False
        merged: dict[str, Any] = {}
        for k, info in enumerate(infos):
            if info:
                merged = self._add_info(merged, info, k)
        return observation, reward.copy(), terminated.copy(), truncated.copy(), merged

    def _start(self, which: list[int]) -> tuple[Observation, dict[int, dict[str, Any]]]:
        self._steps[which] = 0
        return self.episodes.reset(which, self._rngs)


class InsertionVectorEnv(ProbeVectorEnv):
    """Native batch of ``probe_env/Insertion-v1``."""

    single = InsertionEnv


class SnapshotVectorEnv(ProbeVectorEnv):
    """Native batch of ``probe_env/Snapshot-v1``."""

    single = SnapshotEnv


class InspectionVectorEnv(ProbeVectorEnv):
    """Native batch of ``probe_env/Inspection-v0``."""

    single = InspectionEnv
