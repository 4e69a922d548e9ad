"""Where methods stop: the map over scenes, one mass, energy, digits."""
