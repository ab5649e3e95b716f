"""Opens the cluster that a run asks for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from etendue.core import OptionError

if TYPE_CHECKING:
    from .cluster import Cluster


@contextmanager
def opened_cluster(
    cluster: Any = None, workers: int | None = None, threads: int | None = None
) -> Iterator[Cluster | None]:
    """The cluster at an address, that of a ``distributed.Client``, or one of local ``workers``, which end with the
    block; ``None`` if neither is given.

    Raises :class:`OptionError`, :class:`BackendError` if Dask is not installed, :class:`ClusterError`.
    """
    opened = open_cluster(cluster, workers, threads)
    if opened is None:
        yield None
        return
    with opened:
        yield opened


def open_cluster(cluster: Any = None, workers: int | None = None, threads: int | None = None) -> Cluster | None:
    """As :func:`opened_cluster`; the caller closes it."""
    if cluster is None and workers is None:
        return None  # and import nothing, as in most runs
    from .cluster import Cluster
    from .dask import DaskPool
    from .processes import ProcessPool

    if cluster is None:
        assert workers is not None
        return Cluster(ProcessPool(workers, None if threads is None else max(1, threads // workers)))
    if workers is not None:
        raise OptionError("workers are processes of this machine, a cluster has its own: give one of them")
    return Cluster(DaskPool(cluster))
