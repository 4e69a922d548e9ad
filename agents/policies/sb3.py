"""A model of Stable-Baselines3 as a policy or a bundle.

Its own zip file is a pickle, which can run any code, so commands take bundles alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from agents.policies.bundle import Agent, Algorithm, Description, Network, write_bundle
from agents.policies.view import View
from probe_env.envs.task import TaskConfig

KINDS: Final[tuple[tuple[type[BaseAlgorithm], Algorithm], ...]] = (
    (RecurrentPPO, "recurrent-ppo"), (PPO, "ppo"), (SAC, "sac"),
)  # fmt: skip
KNOWN: Final = ("net_arch", "log_std_init", "lstm_hidden_size", "ortho_init", "use_sde")
"""Arguments of a policy that a bundle describes, or that change nothing after training."""


def from_sb3(model: BaseAlgorithm, config: TaskConfig) -> Agent:
    """A model as a policy: for a ``Plan`` of an evaluation, in every task that shows what it was trained on.

    Args:
        model: trained on ``ProbeVecEnv(config=config)`` or an environment of that task, without wrappers that change
            observations or actions.
        config: the task that it was trained in.

    Raises:
        ValueError: the model is of another kind, or of other spaces than the task.
    """
    return Agent(described(model, config), model.policy, config.all_shown)


def save_bundle(path: str | Path, model: BaseAlgorithm, config: TaskConfig) -> str:
    """Write a model as a bundle, which every command takes; returns its hash.

    Args:
        path: of the bundle (.safetensors).
        model: see ``from_sb3``.
        config: see ``from_sb3``.

    Raises:
        ValueError: as ``from_sb3``, or the policy has arguments that a bundle does not describe.
    """
    unknown = sorted(set(model.policy_kwargs) - set(KNOWN))
    if unknown or isinstance(model.policy_kwargs.get("net_arch"), dict):
        what = ", ".join(unknown) or "net_arch with different networks"
        raise ValueError(f"policy_kwargs: a bundle does not describe {what}")
    return write_bundle(Path(path), described(model, config), model.policy)


def described(model: BaseAlgorithm, config: TaskConfig) -> Description:
    """What a bundle says of a model that sees the task's observations and acts as the task means it."""
    algorithm = next((name for kind, name in KINDS if isinstance(model, kind)), None)
    if algorithm is None:
        raise ValueError(f"model is a {type(model).__name__}; {', '.join(k.__name__ for k, _ in KINDS)} are accepted")
    view = View(observations=tuple(config.observations), averages=(), logarithmic_feed=False)
    for name, given, wanted in zip(
        ("observation_space", "action_space"), (model.observation_space, model.action_space), view.spaces, strict=True
    ):
        if given.shape != wanted.shape:
            raise ValueError(f"{name} of the model has shape {given.shape}; that of the task is {wanted.shape}")
    if isinstance(model.get_env(), VecNormalize):
        raise ValueError("model was trained with VecNormalize, whose statistics a policy alone does not have")
    trained = {"by": "stable_baselines3", "steps": int(model.num_timesteps), "seed": model.seed}
    return Description(algorithm=algorithm, network=_network(model), view=view, task=config, trained=trained)


def _network(model: BaseAlgorithm) -> Network:
    values = {name: value for name, value in model.policy_kwargs.items() if name == "log_std_init"}
    memory = getattr(model.policy, "lstm_actor", None)
    if memory is not None:
        values["lstm_hidden_size"] = memory.hidden_size
    shape = getattr(model.policy, "net_arch", None)
    if isinstance(shape, dict):  # equal networks of actor and critic
        shape = shape.get("pi", shape.get("vf"))
    return Network(net_arch=tuple(shape or ()), **values)
