"""Lights: their power, choice and points, as tables that kernels read."""
