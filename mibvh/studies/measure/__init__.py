"""What is measured of a scene: rays, trees, what they cost and how long they take."""
