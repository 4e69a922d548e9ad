"""Pictures of a probe in its tube."""
