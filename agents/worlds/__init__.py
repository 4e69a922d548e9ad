"""The vibration map as a world to train in: actions enter, observations and rewards leave, nothing is simulated.

``noise`` is what the map leaves out, ``measure`` finds it and how far rewards are off, ``map_episodes`` is the world
and ``vec_env`` gives it to Stable-Baselines3. Imports policies, the batch for Stable-Baselines3 and the task.
"""
