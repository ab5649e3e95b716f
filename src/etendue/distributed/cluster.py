"""Clusters: worker processes that make the passes of runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self

from etendue.core import Iterations, OptionError
from etendue.engine import Job, MakeExecutor, Replicated

from .dask import DaskPool
from .pool import Pool
from .processes import ProcessPool
from .recipes import recipe
from .spread import Spread


class Cluster:
    """Makes the passes of runs in the workers of a pool. Several runs may follow each other. The end of a ``with``
    block ends the workers that were started for the cluster."""

    def __init__(self, pool: Pool) -> None:
        self.pool = pool

    def executor(self, job: Job, longest: int | None = None) -> MakeExecutor:
        """The executor of a job. If the passes depend on each other, the job gets a method with a replica for each
        worker; a job that continues from a state keeps its replicas, or has one. ``longest``: largest number of passes
        that a worker adds up before it sends them. Raises :class:`SceneError` for a source that cannot be sent."""
        method = job.method.method if isinstance(job.method, Replicated) else job.method
        make, arrays = method.for_workers()
        made = recipe(job.ingredients(), method, job.problem.fingerprint, arrays, make)
        if method.carries_on and job.method is method:
            count = len(self.pool.workers()) if job.state is None else 1
            if job.state is not None:
                done = Iterations() if job.start is None else job.start.iterations
                job.state = {"replicas": [job.state], "passes": [done.next_iteration()]}
            job.method = Replicated(method, job.problem, job.seed, count)
        return lambda order: Spread(self.pool, made, order, method.attributes_for_workers(), longest=longest)

    def close(self) -> None:
        """End workers that were started for this cluster."""
        self.pool.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


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
        return None
    if cluster is None:
        assert workers is not None
        return Cluster(ProcessPool(workers, None if threads is None else max(1, threads // workers)))
    if workers is not None:
        raise OptionError("workers are processes of this machine, a cluster has its own: give one of them")
    return Cluster(DaskPool(cluster))
