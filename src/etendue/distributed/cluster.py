"""Clusters: worker processes that make the passes of runs."""

from __future__ import annotations

from typing import Self

from etendue.core import Iterations
from etendue.engine import Job, MakeExecutor, Replicated

from .pool import Pool
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
