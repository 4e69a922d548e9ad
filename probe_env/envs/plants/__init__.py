"""A plant's own tubes: what is known of them enters as one file, scene, task and tubes to simulate leave.

Imports contexts and the task of ``envs``, scenes and settings; knows no simulator and no environment.
"""

from probe_env.envs.plants.plant import GivenPlant, Plant, map_beside, plant_of
from probe_env.envs.plants.tables import Between, Figure, Normal

__all__ = ["Between", "Figure", "GivenPlant", "Normal", "Plant", "map_beside", "plant_of"]
