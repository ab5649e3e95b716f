"""Where light was found, learned cell by cell of the scene: directions, the choice of lights, and a walk by both."""
