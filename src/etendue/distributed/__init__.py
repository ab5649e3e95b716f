"""Distributed: passes of a run in several processes, on this machine or on a cluster of Dask."""

from .cluster import Cluster, opened_cluster
from .content import Entry, Offered, Store
from .dask import DaskPool
from .pool import Arrival, Lost, Pool
from .processes import ProcessPool
from .recipe import Ingredients, Recipe, recipe, scene_ingredients
from .spread import Spread
from .worker import Chunk

__all__ = [
    "Arrival",
    "Chunk",
    "Cluster",
    "DaskPool",
    "Entry",
    "Ingredients",
    "Lost",
    "Offered",
    "Pool",
    "ProcessPool",
    "Recipe",
    "Spread",
    "Store",
    "opened_cluster",
    "recipe",
    "scene_ingredients",
]
