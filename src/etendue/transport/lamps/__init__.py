"""Points on lights, their sampling and densities."""
