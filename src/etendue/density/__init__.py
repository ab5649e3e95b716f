"""Density estimation: kernels, and neighbour search on device arrays. Surfaces and lights are unknown here."""

from .hashgrid import HashGrid, Query
from .kdtree import KdTree
from .kernels import KERNELS

__all__ = ["KERNELS", "HashGrid", "KdTree", "Query"]
