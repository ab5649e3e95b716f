"""Path guiding: learned distributions of directions and of the choice of lights, and the walk that samples them."""
