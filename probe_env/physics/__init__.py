"""Simulation of the cable in the tube: displacements, forces and statistics of a scene; no rewards, no Gymnasium."""
