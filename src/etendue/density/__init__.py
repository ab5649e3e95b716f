"""Density estimation: neighbour search on device arrays. Surfaces and lights are unknown here."""

from .hashgrid import HashGrid, Query

__all__ = ["HashGrid", "Query"]
