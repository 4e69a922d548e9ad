"""Gymnasium environments: wrappers of ``Episodes`` with one probe, or with N in one batch for ``make_vec``."""

import operator
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, SupportsFloat, Unpack

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.actions import step_action
from probe_env.envs.episodes.starts import EpisodeSettings, reset_options
from probe_env.envs.task.config import TaskConfig
from probe_env.settings import Model, one_line_errors

if TYPE_CHECKING:
    from probe_env.envs.pictures.episode import Renderer

Observation = npt.NDArray[np.float32]
RENDER_MODES = ("rgb_array", "human")


def spaces_of(config: TaskConfig) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Observation and action space of a task."""
    low, high = np.array([bounds[:2] for bounds in config.observations.values()], dtype=np.float32).T
    return gym.spaces.Box(low, high, dtype=np.float32), gym.spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)


def to_json(value: Any) -> Any:
    """An argument of ``make`` as JSON can store it: settings as mappings, paths and modes as text, recursively."""
    match value:
        case Model():
            return value.model_dump(mode="json")
        case Mapping():
            return {name: to_json(entry) for name, entry in value.items()}
        case list() | tuple():
            return [to_json(entry) for entry in value]
        case Path():
            return str(value)
        case Enum():
            return value.value
        case _:
            return value


class StepLimitSpec:
    """An environment whose ``spec`` says how many steps an episode has at most, and can be stored as JSON.

    The number is not registered, because it depends on the arguments: Gymnasium would truncate at the registered one.
    """

    max_steps: int
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Specification by ``gymnasium.make``, with ``max_episode_steps`` and plain arguments."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec and replace(spec, max_episode_steps=self.max_steps, kwargs=to_json(spec.kwargs))


class ProbeEnv(StepLimitSpec, gym.Env[Observation, Observation]):
    """Base class of the environments with one probe; see ``InsertionEnv`` for the arguments."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # type: ignore[misc]
    defaults: ClassVar[dict[str, Any]] = {}

    @one_line_errors()
    def __init__(
        self,
        config: TaskConfig | Mapping[str, Any] | None = None,
        *,
        render_mode: str | None = None,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(f"render_mode = {render_mode!r} is not one of {', '.join(RENDER_MODES)}")
        self.episodes = Episodes(1, config, defaults=self.defaults, threads=1, caller="gym.make", **settings)
        self.config = self.episodes.config
        self.max_steps = self.config.max_actions
        if not self.episodes.backend.samples:
            if render_mode is not None:
                raise ValueError(f"render_mode = {render_mode!r}: fidelity 'surrogate' simulates no motion to render")
            self.metadata = self.metadata | {"render_modes": []}  # type: ignore[misc]
        self.observation_space, self.action_space = spaces_of(self.config)  # type: ignore[assignment]
        self.render_mode = render_mode
        self._renderer: Renderer | None = None

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.episodes!r}>"

    @one_line_errors()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see ``Episodes.reset`` for the options."""
        super().reset(seed=seed)
        observation, infos = self.episodes.reset([0], {0: self.np_random}, {0: options})
        if self.render_mode is not None:
            from probe_env.envs.pictures.episode import Renderer  # imports matplotlib

            self._renderer = self._renderer or Renderer(self.episodes)
            self._renderer.begin(infos[0])
            if self.render_mode == "human":
                self.render()
        return observation[0], infos[0]

    def step(self, action: Observation) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Apply an action: one control period towards a target feed speed and air supply, or as the task says."""
        step = step_action(self.episodes, action, (2,))
        reward = float(step.reward[0])
        if self._renderer is not None:
            self._renderer.add(step.infos[0], reward)
            if self.render_mode == "human":
                self.render()
        return step.observation[0], reward, bool(step.terminated[0]), bool(step.truncated[0]), step.infos[0]

    def render(self) -> npt.NDArray[np.uint8] | None:
        """RGB picture (h, w, 3) of the current period; with "human" it is shown in a window and None is returned."""
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
    """Feed a probe into a helical tube, fast while it is quiet and slowly where it vibrates.

    ## Description
    A cable with floats is fed into a helical tube. An air stream pulls it and the feed device holds it back. Beyond
    some inserted length the probe vibrates and its signal becomes noisy. That length depends on friction and drag,
    which are not observed. One episode feeds the probe from 5 m (or its guide length + 2.5 m) to the end of the helix
    at 60 m.

    ## Action Space
    `Box(-1, 1, (2,), float32)`, mapped linearly:

    | Num | Action | Min | Max | Unit |
    |---|---|---|---|---|
    | 0 | target feed speed; the feed ramps at 0.5 m/s2 | 0.02 | 0.4 | m/s |
    | 1 | target air supply; follows with a lag of 1 s | 30 | 130 | m3/h |

    Ramp and lag are those of the simulated motion: at `fast`, which simulates a quarter of each second, they take four
    times as long in the time of the task.

    ## Observation Space
    `Box` of float32; names, bounds and meaning are in `probe_env.envs.task.scales.OBSERVATIONS`:

    | Num | Observation | Scale |
    |---|---|---|
    | 0, 1 | inserted and remaining length | 60 m |
    | 2, 3 | applied feed speed, applied air supply | 0.4 m/s, 130 m3/h |
    | 4, 5 | radial and axial accelerometer, rms | log10, 1 m/s2 |
    | 6 | eddy-current noise, proportional to the radial rms (5 % sensor noise) | log10, 0.1 mm |
    | 7 | mean root tension (2 % sensor noise; the load cell ends at 10 kN) | 20 N |
    | 8, 9 | previous action | - |
    | 10 | helix diameter | 2.5 m |

    `config={"observe_root_tension": False}` removes 7. `{"privileged": True}` adds friction, contact stiffness and
    drag, which a rig cannot measure. `{"observe_probe": True}` adds the seven properties of the probe
    (`probe_env.envs.task.scales.PROBE`), for one controller of many probes.

    ## Rewards
    The sum of `info["reward_terms"]`: progress (1 per metre), vibration (-(rms / 0.1 mm)^2 per metre, the ratio up
    to 3), time (-0.1 per second), air (-0.2 per m3), jerk (-0.005 times the squared change of the action),
    uninspected (per metre that is not inspected when the episode ends, the largest cost of inspecting a metre plus
    its progress), diverged (-10). Weights are fields of `probe_env.TaskConfig`.

    `info["cost"]` is separate from the reward. It is the sum of `info["cost_terms"]`, each 0 or 1 per period:
    lost_drive (tension too low to drive, see Episode End), tension (above `tension_limit`, default 110 N), buckling
    (compression at the root above the buckling load between two floats).

    ## Starting State
    A context is sampled (friction 0.10-0.25, contact stiffness 0.7e5-1.4e5 N/m, drag +-10 %, one of six helix
    diameters); the probe settles for 2 s at 0.2 m/s and 63 m3/h. `options` of `reset` set any field of the context. If
    the time step or the model cannot simulate a context, `reset` raises a `ValueError` that names it, see
    `probe_env.envs.episodes.limits`.

    ## Episode End
    Terminated at the end of the helix, on lost drive (mean root tension below 0.8 N, an assumption for the rising
    straight part, in 3 consecutive periods from 15 m of inserted length on) and when the simulation diverges
    (`info["diverged"]`, with the last finite observation); truncated after 900 s.
    The last `info` has the figures of the episode in `episode_kpis`.

    ## Arguments
    * `config`: fields of `TaskConfig` to change, or a whole `TaskConfig`.
    * `tube`: your own plant: the path of its `tube.toml`, its fields as a mapping, or a `probe_env.Plant`. It sets the
      scene, the ranges and limits of the task, and the distribution of friction, stiffness and drag from which random
      contexts are sampled. `config` then changes fields of its task.
    * `scene`: base scene without a `tube`; default table 2 of the study, with all that the study leaves out. A `Scene`
      (`probe_env.Scene()` is the study's model), or a mapping of changed fields of the default such as
      `{"tube": {"inner_diameter": 0.025}}`, which `spec.to_json()` can store.
    * `fidelity`: "fast" (default), another preset, "auto" or settings, see `probe_env.fidelity`. "surrogate"
      predicts from a vibration map instead of simulating, tens of times faster, for training; it has no render mode.
    * `surrogate_map`: file of the map, for "surrogate" only. Default: NAME-map.npz next to the file of the `tube`, if
      it exists, else the map of table 2's tubes.
    * `contexts`: "random", a shipped list ("train", "validation", "test"), your own list of `Context`s or mappings, or
      `Ranges` to sample from.
    * `in_turn`: with a list of contexts, episodes take its tubes in order instead of at random, from the first one
      after `reset(seed=...)`. Environment i of a batch of N begins at tube i and goes on by N: if N divides 24, 24
      episodes are the 24 validation tubes. `options={"context": ...}` of `reset` sets a whole context.
    * `feed_speed`, `air_supply_rate`: while the probe settles, SI units; default 0.2 m/s and 63 m3/h, or the nearest
      values in range.
    * `probes`: "scene", or "random": every reset samples a `probe_env.Design` from the whole design space, so that one
      agent serves many probes. `info["probe"]` of `reset` holds it, and the observation with
      `config={"observe_probe": True}`. A constant length is cut to whole pitches.
    * `render_mode`: "rgb_array" or "human".
    """


class IncrementalInsertionEnv(InsertionEnv):
    """`Insertion-v1` for training: an action changes feed and air, and is applied for two seconds.

    ## Description
    Tubes, physics, reward, costs, arguments and end are those of `Insertion-v1`. Only the interface differs:

    * An action in `Box(-1, 1, (2,), float32)` changes the targets of feed and air, which end at their ranges. It raises
      the feed by up to 35 % or lowers it by up to 45 % (a tenth and a fifth of its range on a logarithmic scale:
      `change_per_action`, `feed_decrease_per_action`), and changes the air by up to 5.75 m3/h. The least air is
      72.5 m3/h, enough for the drive in all tubes of the lists: with less it is lost, too rarely for an agent to learn.
    * An action is applied for two control periods of 1 s (`periods_per_action`). Rewards and costs are summed over
      them; accelerations, eddy-current noise and root tension are observed as means. Truncated after 450 steps.

    Why: PPO explores with Gaussian noise of standard deviation 1. Where the action is the target itself, this noise is
    cut at the ends of the range, so that the mean of a policy that trains well crawls. A change integrates the noise,
    and its mean behaves as in training.

    The observations `previous_feed_action` and `previous_air_action` hold the targets, scaled by their ranges.
    """

    defaults: ClassVar[dict[str, Any]] = {
        "periods_per_action": 2, "change_per_action": 0.1, "feed_decrease_per_action": 0.2, "logarithmic_change": True,
        "shaping_weight": 2.0, "air_supply_rates": (72.5 / 3600.0, 130.0 / 3600.0),
    }  # fmt: skip


class SnapshotEnv(ProbeEnv):
    """A probe of constant length, as in the figures of the study, for quick tests and comparison.

    ## Description
    As `Insertion-v1`, but the inserted length is constant: carrier length of the scene (50 m) or the option
    `carrier_length`. The feed counts as inspected length. Control period 0.1 s, truncated after 8 s.

    Actions, observations, rewards and arguments are those of `Insertion-v1`; `uninspected` is 0.

    ## Starting State
    At rest, then one period with the initial feed and air.

    ## Episode End
    Truncated after 8 s; terminated on lost drive and when the simulation diverges.
    """

    defaults: ClassVar[dict[str, Any]] = {"growing": False, "period": 0.1, "time_limit": 8.0, "settle_time": 0.1}


class InspectionEnv(ProbeEnv):
    """A round trip: insert a probe, withdraw it, and inspect on both passes.

    ## Description
    The probe is inserted as in `Insertion-v1`. At the end of the helix feed and air reverse: the air blows towards the
    feed device, which withdraws the cable to its initial length. On withdrawal the cable is under compression and lies
    on the outer wall, where it hardly vibrates. A metre is scored by the better of both passes.

    ## Action Space
    As `Insertion-v1`: magnitude of feed speed and air supply, in the direction of the current pass.

    ## Observation Space
    As `Insertion-v1`; feed speed and air supply are negative on withdrawal. `direction` follows before any privileged
    observations: 1 on insertion, -1 on withdrawal.

    ## Rewards
    As `Insertion-v1`, with time and air of both passes. `config={"scored_pass": "best"}` (default): if a metre is
    quieter on withdrawal than on insertion, its vibration cost is reduced to that of withdrawal. `"insertion"` and
    `"withdrawal"` score one pass only. Detection KPIs use the same passes: with `"best"` a flaw is detected if either
    pass calls it, each with half of the false calls. In all three, uninspected is the remaining length of both passes
    when the episode ends: a probe that stays in the tube is charged for the metres that it was not withdrawn.

    ## Episode End
    Terminated when the probe is back at its initial length, on lost drive during insertion, and when the simulation
    diverges; truncated after 1,800 s.

    ## Arguments
    As `Insertion-v1`. Withdrawal needs nodes between the floats: `fidelity` "standard" or "fast", or settings with
    newmark, wilson, imex, implicit or explicit. Time-lapse ("fast") applies to insertion only, because the motion on
    withdrawal is a transient of the turn or of a change of feed. The cable touches the walls in every scene.
    """

    defaults: ClassVar[dict[str, Any]] = {"passes": "both", "time_limit": 1800.0}


class ProbeVectorEnv(StepLimitSpec, gym.vector.VectorEnv[Observation, Observation, Any]):
    """N environments in one batch; each equals a single environment with the seed ``seed + i`` bit for bit.

    Args:
        num_envs: N.
        autoreset_mode: when an ended episode restarts: ``AutoresetMode.NEXT_STEP`` (default), ``SAME_STEP``
            (with ``final_obs`` and ``final_info`` in the infos) or ``DISABLED`` (``options["reset_mask"]``).
        threads: maximum number of threads; default: all cores.
        config, settings: see ``InsertionEnv``.
        max_episode_steps: number of steps after which an episode is truncated, as in ``gymnasium.make``; default: only
            the time limit of ``config``.
        render_mode: must be None: render a single environment.
    """

    single: ClassVar[type[ProbeEnv]] = ProbeEnv

    @one_line_errors()
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
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ValueError(f"max_episode_steps = {max_episode_steps!r} is outside the accepted range 1 and more")
        if render_mode is not None:
            raise ValueError(f"render_mode = {render_mode!r}: a batch is not rendered; use gym.make")
        self.episodes = Episodes(
            num_envs, config, defaults=self.single.defaults, threads=threads, caller="gym.make_vec", **settings
        )
        self.config = self.episodes.config
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = self.single.metadata | {"autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = spaces_of(self.config)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs: dict[int, np.random.Generator] = {}
        self._seeds = [-1] * num_envs
        self._ended = np.zeros(num_envs, dtype=bool)
        self.max_episode_steps, self._steps = max_episode_steps, np.zeros(num_envs, dtype=int)
        self.max_steps = min(max_episode_steps or self.config.max_actions, self.config.max_actions)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]  # as SyncVectorEnv
        """Seeds of the generators of the N environments."""
        self._seed(range(self.num_envs))
        return tuple(self._seeds)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Generators of the N environments."""
        self._seed(range(self.num_envs))
        return tuple(self._rngs[k] for k in range(self.num_envs))

    def _seed(self, which: Iterable[int], seeds: Sequence[int | None] | None = None) -> None:
        """Make generators of environments that have a seed, or had no generator; other generators continue."""
        for k in which:
            seed = None if seeds is None else seeds[k]
            if seed is not None or k not in self._rngs:
                self._rngs[k], self._seeds[k] = gym.utils.seeding.np_random(seed)

    @one_line_errors()
    def reset(
        self,
        *,
        seed: int | np.integer[Any] | Sequence[int | np.integer[Any] | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start all episodes, or those of ``options["reset_mask"]``. Other options: see ``Episodes.reset``."""
        options = reset_options(options)
        mask = options.pop("reset_mask", None)
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"options['reset_mask'] must be {self.num_envs} booleans, at least one of them true")
        which = np.flatnonzero(mask).tolist()
        seeds: list[int | None] | None = None
        if isinstance(seed, int | np.integer):
            seeds = [int(seed) + k for k in range(self.num_envs)]
        elif seed is not None:
            seeds = [None if entry is None else operator.index(entry) for entry in seed]
        if seeds is not None and len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries for {self.num_envs} environments")
        observation, infos = self.start(which, seeds, dict.fromkeys(which, options))
        merged: dict[str, Any] = {}
        for k in which:
            merged = self._add_info(merged, infos[k], k)
        return observation, merged

    def start(
        self, which: Sequence[int], seeds: Sequence[int | None] | None, options: Mapping[int, dict[str, Any] | None]
    ) -> tuple[Observation, dict[int, dict[str, Any]]]:
        """Start episodes; observations (N, d) of all environments and the info of each started one."""
        self._seed(which, seeds)
        self._ended[which], self._steps[which] = False, 0
        return self.episodes.reset(which, self._rngs, options)

    def step(
        self, actions: npt.ArrayLike
    ) -> tuple[Observation, FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Apply an action to each probe; ended episodes restart according to ``autoreset_mode``."""
        observation, reward, terminated, truncated, infos = self.advance(actions)
        merged: dict[str, Any] = {}
        for k, info in enumerate(infos):
            if info:
                merged = self._add_info(merged, info, k)
        return observation, reward, terminated, truncated, merged

    def advance(
        self, actions: npt.ArrayLike
    ) -> tuple[Observation, FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """``step`` with one info for each environment."""
        starting = self._ended.copy()
        if starting.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(f"episode {np.flatnonzero(starting)[0]} has ended: reset it with options['reset_mask']")
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        reward: FloatArray = np.zeros(self.num_envs)
        terminated, truncated = np.zeros_like(starting), np.zeros_like(starting)
        observation = self.episodes.observation.copy()
        if not starting.all():
            step = step_action(self.episodes, actions, (self.num_envs, 2), ~starting)
            observation, reward, terminated, truncated = step.observation, step.reward, step.terminated, step.truncated
            infos = step.infos
            self._steps += ~starting
            if self.max_episode_steps is not None:
                truncated = truncated | (~starting & (self._steps >= self.max_episode_steps))
        self._ended = terminated | truncated | starting
        same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        starting = self._ended.copy() if same_step else starting  # with NEXT_STEP this step is their reset
        if starting.any():
            which, final = np.flatnonzero(starting).tolist(), observation.copy()
            first, started = self.start(which, None, {})
            observation[which] = first[which]
            for k in which:
                infos[k] = started[k] | ({"final_obs": final[k], "final_info": infos[k]} if same_step else {})
        return observation, reward.copy(), terminated.copy(), truncated.copy(), infos


# VectorEnv is among their direct bases because skrl recognises a batch by that
class InsertionVectorEnv(ProbeVectorEnv, gym.vector.VectorEnv[Observation, Observation, Any]):
    """Native batch of ``probe_env/Insertion-v1``."""

    single = InsertionEnv


class IncrementalInsertionVectorEnv(ProbeVectorEnv, gym.vector.VectorEnv[Observation, Observation, Any]):
    """Native batch of ``probe_env/IncrementalInsertion-v1``."""

    single = IncrementalInsertionEnv


class SnapshotVectorEnv(ProbeVectorEnv, gym.vector.VectorEnv[Observation, Observation, Any]):
    """Native batch of ``probe_env/Snapshot-v1``."""

    single = SnapshotEnv


class InspectionVectorEnv(ProbeVectorEnv, gym.vector.VectorEnv[Observation, Observation, Any]):
    """Native batch of ``probe_env/Inspection-v0``."""

    single = InspectionEnv
