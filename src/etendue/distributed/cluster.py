"""Clusters: worker processes that make the passes of runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

from etendue.core import Iterations, Method, SceneError, State
from etendue.engine import Executor, Job, MakeExecutor, Order, Replicated

from .dask import DaskPool
from .pool import Pool
from .recipe import Recipe, recipe, scene_ingredients
from .spread import Spread


class Cluster:
    """Makes the passes of runs in the workers of a pool. Several runs may follow each other. The end of a ``with``
    block ends the workers that were started for the cluster."""

    def __init__(self, pool: Pool) -> None:
        self.pool = pool

    def rendering(self, job: Job, longest: int | None = None) -> MakeExecutor:
        """The executor of a job with a scene. If the passes depend on each other, the job gets the method and state of
        :meth:`replicate`. ``longest``: largest number of passes that a worker adds up before it sends them. Raises
        :class:`SceneError` for a scene in memory."""
        if job.task is None:
            raise SceneError("a scene in memory cannot be sent to workers; give its file or its dictionary")
        plain: Any = job.method.method if isinstance(job.method, Replicated) else job.method
        made = recipe(scene_ingredients(job.task), plain, job.problem.fingerprint)
        done = Iterations() if job.start is None else job.start.iterations
        job.method, job.state = self.replicate(job.method, job.problem, job.seed, job.state, done)
        return self.executor(made, longest=longest)

    def replicate(
        self, method: Method, problem: Any, seed: int, state: State | None, done: Iterations
    ) -> tuple[Method, State | None]:
        """The method and its state; if passes depend on each other, with a replica for each worker. A method that
        continues from ``state`` after the passes ``done`` keeps its replicas, or becomes the only replica."""
        if not method.carries_on or isinstance(method, Replicated):
            return method, state
        if state is not None:
            state = {"replicas": [state], "passes": [done.next_iteration()]}
        count = len(self.pool.workers()) if state is None else 1
        return Replicated(method, problem, seed, count), state

    def executor(
        self, made: Recipe, attributes: Mapping[str, Any] | None = None, longest: int | None = None
    ) -> MakeExecutor:
        """The executor of a run; ``attributes`` are set on its method in the workers."""

        def make(order: Order) -> Executor:
            return Spread(self.pool, made, order, attributes, longest=longest)

        return make

    def close(self) -> None:
        """End workers that were started for this cluster."""
        self.pool.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
    return Cluster(DaskPool(cluster, workers=workers, threads=threads))
