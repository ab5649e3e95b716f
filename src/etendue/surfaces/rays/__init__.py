"""Rays from the sides of patches and against them."""
