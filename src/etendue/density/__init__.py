"""Density estimation: neighbour search on device arrays. Surfaces and lights are unknown here."""

from .hashgrid import HashGrid, Query
from .kdtree import KdTree

__all__ = ["HashGrid", "KdTree", "Query"]
