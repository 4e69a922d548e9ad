"""Simulation of the cable in the tube: scenes in; displacements, forces and statistics out; no rewards, no Gymnasium."""
