"""Simulation of the cable in the tube: scenes in; displacements, forces and statistics out. Knows no rewards."""
