"""Episodes predicted from a vibration map instead of simulated: the fidelity "surrogate"."""

from probe_env.envs.surrogate.episodes import SurrogateEpisodes, make_episodes

__all__ = ["SurrogateEpisodes", "make_episodes"]
