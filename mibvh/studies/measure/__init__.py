"""Measurements of a scene: rays, trees, counts and times."""
