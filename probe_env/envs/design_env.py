"""Design-v1: the action is the design of a probe."""

from collections.abc import Mapping
from typing import Any, ClassVar, Unpack, cast

import gymnasium as gym
import numpy as np

from probe_env.design import RANGES, Design
from probe_env.envs.contexts import Context
from probe_env.envs.env import Observation, StepLimitSpec
from probe_env.envs.episodes.starts import (
    DEFAULTS,
    EpisodeSampler,
    EpisodeSettings,
    SceneSettings,
    reset_options,
    resolve_settings,
    restored_on_error,
    sample_context,
)
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import OBSERVATIONS, PRIVILEGED, UNITS, action_of, as_actions, fraction_of
from probe_env.envs.trials import (
    HARDEST,
    Candidate,
    Controller,
    check_candidate,
    score_designs,
    segment_of,
    try_insertions,
    try_sections,
)
from probe_env.fidelity import resolve_fidelity
from probe_env.scene import Scene
from probe_env.schedule import Schedule
from probe_env.settings import check_keywords, one_line_errors

STUDY_FEED = Schedule("inserted_length", "linear", (5.0,), (0.2,), (63.0 / 3600.0,))


class DesignEnv(StepLimitSpec, gym.Env[Observation, Observation]):
    """Design a probe and score it in one tube: one step per episode.

    ## Description
    The action is a probe design. The step builds the probe and simulates it in one tube under a fixed feed, either in
    sections of constant length or, with `full=True`, in a whole insertion. In the study's helix of 60 m there are five
    sections, with the sensor 10, 20, ... 50 m from the entrance; each settles for 1 s and is measured for 2 s. All
    probes are compared over the same segment of tube, from 2.5 m to 10 m before the end of the helix, which the sensor
    reaches with the longest guide: 47.5 m of 60 m.

    ## Action Space
    `Box(-1, 1, (7,), float32)`, mapped linearly:

    | Num | Action | Min | Max | Unit |
    |---|---|---|---|---|
    | 0 | guide length, rounded to whole pitches | 1 | 10 | m |
    | 1 | diameter of the guide's floats | 0.016 | 0.020 | m |
    | 2 | diameter of the carrier's floats | 0.016 | 0.020 | m |
    | 3 | float pitch, rounded to 1 mm | 0.05 | 0.15 | m |
    | 4 | tensile rigidity | 0.5e5 | 2e5 | N |
    | 5 | flexural rigidity | 0.025 | 0.1 | N m2 |
    | 6 | line density | 0.09 | 0.14 | kg/m |

    `action_of` converts a `Design` to an action. Floats that do not fit the bore with 1 mm of clearance are built as
    large as fits; `info["design"]` is the probe as built. 10 m and 20 mm are the study's limits (handling, weld
    projections); the other ranges are assumptions.

    ## Observation Space
    `Box(0, 4000, (1,), float32)`: helix diameter / 2.5 m. `config={"privileged": True}` adds friction / 0.25, contact
    stiffness / 1e5 N/m and drag relative to table 2.

    ## Rewards
    The sum of `info["reward_terms"]`, with the weights of `Insertion-v1`: progress (1 per metre that the sensor
    inspects: a long guide inspects less), vibration, time and air over the shared segment, uninspected (per metre of
    the segment after the probe loses its drive or diverges), diverged (-10).

    ## Starting State
    A context is sampled as in `Insertion-v1`; `options` of `reset` set some of its fields, or the whole "context".

    ## Episode End
    Terminated after one step. `info` then has `design` (as built), `kpis` (radial rms, share within the limit,
    inspection time, air, inspected length, drive margin: least mean root tension minus the required tension, ...).
    Whole insertions add a50 and a90, length with a signal-to-noise over 3, and noise peak to peak.

    ## Arguments
    * `config`, `scene`, `contexts`, `tube`: as for `Insertion-v1`.
    * `fidelity`: preset or settings; default "fast", whose time-lapse applies to whole insertions only.
    * `feed`: `Schedule` over inserted length; default the study's 0.2 m/s and 63 m3/h, or the nearest values in
      the task's range. For whole insertions also a policy with SB3's `predict`.
    * `full`: whole insertions instead of sections; each takes about 5 s.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]
    max_steps = 1

    @one_line_errors()
    def __init__(
        self,
        config: TaskConfig | Mapping[str, Any] | None = None,
        *,
        feed: Schedule | Controller | None = None,
        full: bool = False,
        render_mode: str | None = None,
        **settings: Unpack[SceneSettings],
    ) -> None:
        check_keywords("gym.make", settings, ("config", "feed", "full", *SceneSettings.__annotations__))
        if render_mode is not None:
            raise ValueError(f"render_mode = {render_mode!r}: Design-v1 is not rendered; use Insertion-v1 with options")
        self.config, remaining = resolve_settings({}, config, cast(EpisodeSettings, settings))
        segment_of(self.config)  # raises for a helix that is too short
        # an insertion starts like that of Insertion-v1; the action, not the sampler, builds the probe
        self.sampler = EpisodeSampler(self.config, remaining.get("contexts", DEFAULTS["contexts"]), "random")
        self.fidelity = resolve_fidelity(remaining.get("fidelity", DEFAULTS["fidelity"]), self.sampler.stiffest, full)
        if not self.fidelity.simulates:
            raise ValueError("fidelity = 'surrogate' is for Insertion-v1 only: designs are simulated, use fast")
        self.feed, self.full, self.render_mode = feed or STUDY_FEED, full, render_mode
        if not full and not isinstance(self.feed, Schedule):
            raise ValueError("feed: sections of constant length need a Schedule; a policy needs full = True")
        visible = {"helix_diameter": OBSERVATIONS["helix_diameter"]} | (PRIVILEGED if self.config.privileged else {})
        low, high = np.array([bounds[:2] for bounds in visible.values()], dtype=np.float32).T
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (len(RANGES),), dtype=np.float32)
        self.context: Context | None = None

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.config!r}, {self.fidelity!r}, full={self.full}>"

    @property
    def scene(self) -> Scene:
        """Base scene, before design and context are applied."""
        return self.config.scene

    @staticmethod
    def action_of(design: Design) -> Observation:
        """(7,) action of a design."""
        return action_of(design.to_unit()).astype(np.float32)

    @staticmethod
    def design_of(action: Observation) -> Design:
        """Design of an action (7,) in [-1, 1], before rounding to pitches."""
        values = as_actions(action, (len(RANGES),)).astype(float)
        if not (np.abs(values) <= 1.0 + 1e-6).all():
            raise ValueError(
                f"action = {values.tolist()} must be {len(RANGES)} numbers within -1 to 1: {', '.join(RANGES)}"
            )
        return Design.from_unit(fraction_of(values))

    @one_line_errors()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Sample a tube.

        Raises:
            ValueError: an option is unknown or not valid, or the fidelity or the model cannot simulate every design in
                this tube, see ``episodes.limits``.
        """
        super().reset(seed=seed)
        sections = None if self.full else cast(Schedule, self.feed)
        with restored_on_error([self.np_random]):
            context = sample_context(self.sampler.source, self.np_random, reset_options(options))
            for design in HARDEST:  # then the whole design space, cut to the bore, is accepted
                check_candidate(design.cut_to(self.scene), context, self.config, self.fidelity, sections)
        self.context = context
        return self._observation(), {"context": self.context.model_dump()}

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Build and simulate the probe; the episode ends.

        Raises:
            ValueError: the action is not valid.
            RuntimeError: the episode has ended and was not reset.
        """
        design = self.design_of(action).cut_to(self.scene)
        if self.context is None:
            raise RuntimeError("the episode has ended: call reset before step")
        feed = _Follow(self.feed, self.config) if self.full and isinstance(self.feed, Schedule) else self.feed
        candidate = Candidate(design, self.context, feed, int(self.np_random.integers(2**31)))
        if self.full:
            trial = try_insertions([candidate], self.config, self.fidelity, threads=1)
        else:
            trial = try_sections([candidate], self.config, self.fidelity)
        terms, kpis = score_designs([design], trial, self.config)
        info = {
            "design": design.built.model_dump(),
            "context": self.context.model_dump(),
            "reward_terms": {name: float(values[0]) for name, values in terms.items()},
            "kpis": {name: float(values[0]) for name, values in kpis.items()},
        }
        observation = self._observation()
        self.context = None
        return observation, float(sum(info["reward_terms"].values())), True, False, info

    def _observation(self) -> Observation:
        assert self.context is not None
        names = ["helix_diameter", *(PRIVILEGED if self.config.privileged else ())]
        return np.array([getattr(self.context, name) / UNITS[name] for name in names], dtype=np.float32)


class _Follow:
    """A schedule over inserted length as a controller."""

    def __init__(self, schedule: Schedule, config: TaskConfig) -> None:
        self.schedule, self.config = schedule, config
        self.column = list(config.observations).index("inserted_length")

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Action of the schedule at the observed length."""
        lengths = np.atleast_2d(observation)[:, self.column] * UNITS["inserted_length"]
        pairs = [self.schedule.at(length) for length in lengths]
        return np.array([self.config.actions(feed, air)[0] for feed, air in pairs], dtype=np.float32), ()
