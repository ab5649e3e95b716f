"""Distributed: passes of a run in several processes, on this machine or on a cluster of Dask."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .cluster import Cluster as Cluster
    from .content import ContentFile as ContentFile, Offered as Offered, Store as Store
    from .dask import DaskPool as DaskPool
    from .divided import Divided as Divided, Traffic as Traffic
    from .opening import open_cluster as open_cluster, opened_cluster as opened_cluster
    from .pool import Arrival as Arrival, Lost as Lost, Pool as Pool
    from .processes import ProcessPool as ProcessPool
    from .recipes import Recipe as Recipe, recipe as recipe
    from .rounds import Correspondence as Correspondence, Rounds as Rounds
    from .spread import Spread as Spread
    from .worker import Chunk as Chunk
else:
    __getattr__, __dir__ = on_use(__name__)
