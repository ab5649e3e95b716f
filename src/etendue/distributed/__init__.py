"""Distributed: passes of a run in several processes, on this machine or on a cluster of Dask."""

from .cluster import Cluster, open_cluster, opened_cluster
from .content import Entry, Offered, Store
from .dask import DaskPool
from .divided import Divided, Traffic
from .pool import Arrival, Lost, Pool
from .processes import ProcessPool
from .recipe import Ingredients, Recipe, part_ingredients, recipe, scene_ingredients
from .rounds import Correspondence, Rounds
from .spread import Spread
from .worker import Chunk

__all__ = [
    "Arrival",
    "Chunk",
    "Cluster",
    "Correspondence",
    "DaskPool",
    "Divided",
    "Entry",
    "Ingredients",
    "Lost",
    "Offered",
    "Pool",
    "ProcessPool",
    "Recipe",
    "Rounds",
    "Spread",
    "Store",
    "Traffic",
    "open_cluster",
    "opened_cluster",
    "part_ingredients",
    "recipe",
    "scene_ingredients",
]
