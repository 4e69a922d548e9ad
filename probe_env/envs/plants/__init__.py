"""A plant's own tubes, read from one file: scene, task and tubes to simulate."""

from probe_env.envs.plants.plant import GivenPlant, Plant, map_beside, plant_of
from probe_env.envs.plants.tables import Between, Figure, Normal

__all__ = ["Between", "Figure", "GivenPlant", "Normal", "Plant", "map_beside", "plant_of"]
