"""What worker processes cost and bring: one beside a process of its own, two beside two that know nothing of each
other."""

from __future__ import annotations

import multiprocessing
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import Annotated, Any

import typer

from etendue import methods
from etendue.core import ClusterError, set_threads, use_variant
from etendue.distributed import Cluster, DaskPool
from etendue.engine import Budget, Job, Task
from etendue.jobs import FormFactorRequest, FormFactorWork

from .measuring import Record, spread, verdict
from .options import Methods, Rounds

#: Time of a worker of the cluster relative to a process alone, and throughput of two relative to two alone.
OVERHEAD_BAR, EFFICIENCY_BAR = 1.05, 0.95
_SIZE = (256, 256)


#: What else is measured: lines through a room by the A-buffer, whose passes are divided by their directions.
LINES, _BUNDLES, _AREA = "a-buffer", 8, 4e-3


def measure(
    chosen: Methods = "bpt,vcm",
    lines: Annotated[bool, typer.Option("--lines/--no-lines", help="Also form factors by the A-buffer.")] = True,
    time_: Annotated[float, typer.Option("--time", help="Seconds of a run, about.", metavar="SECONDS")] = 6.0,
    rounds: Rounds = 3,
) -> Record:
    """Seconds of passes in processes of one thread: alone, and as workers of a cluster."""
    record = Record(
        "Worker processes of one thread, cornell-glass 256x256, and form factors of cornell-box",
        ("", "passes", "one worker / one alone", "bar", "two alone / two workers", "bar"),
    )
    spawn = multiprocessing.get_context("spawn")
    with (
        Cluster(DaskPool(workers=1, threads=1)) as one,
        Cluster(DaskPool(workers=2, threads=2)) as two,
        ProcessPoolExecutor(1, spawn) as first,
        ProcessPoolExecutor(1, spawn) as second,
    ):
        alone = [first, second]
        for pool in (one.pool, two.pool):
            _until(pool, 1 if pool is one.pool else 2)
        for name in [*chosen, LINES] if lines else chosen:
            few = 4
            for future in [executor.submit(alone_seconds, name, few) for executor in alone]:
                future.result()  # compiles
            pace = first.submit(alone_seconds, name, few).result() / few
            passes = max(few, round(time_ / pace))
            for cluster in (one, two):
                cluster_seconds(cluster, name, 16)
            costs, gains = [], []
            for _ in range(rounds):
                mine = first.submit(alone_seconds, name, passes).result()
                costs.append(cluster_seconds(one, name, passes) / mine)
                # Both begin when both are ready, and the later one counts.
                begin = time.perf_counter()
                for future in [executor.submit(alone_seconds, name, passes) for executor in alone]:
                    future.result()
                apart = time.perf_counter() - begin
                gains.append(apart / cluster_seconds(two, name, 2 * passes))
            record.add(
                name,
                str(passes),
                spread(costs, ".3f"),
                verdict(statistics.median(costs), OVERHEAD_BAR),
                spread(gains, ".3f"),
                f"≥ {EFFICIENCY_BAR:g}: {'reached' if statistics.median(gains) >= EFFICIENCY_BAR else 'missed'}",
            )
    record.notes.append(
        f"Wall seconds with preparation of the method, processes and scenes kept, in turn, {rounds} rounds after one: "
        "median (least … most)"
    )
    return record


def _task(name: str, passes: int) -> Task:
    return Task("cornell-glass", methods.get(name), {"samples_per_pass": 1}, 0, Budget(iterations=passes), _SIZE)


@cache
def _problem() -> Any:
    use_variant("llvm_ad_rgb")
    set_threads(1)
    return Job.open(_task("path", 1)).problem


def _until(pool: DaskPool, count: int) -> None:
    """Wait until so many workers are there."""
    end = time.monotonic() + 120
    while len(pool.workers()) < count:
        if time.monotonic() > end:
            raise ClusterError(f"{count} workers did not start in two minutes; try on an idle machine")
        time.sleep(0.2)


def _lines(passes: int, cluster: Cluster | None = None) -> float:
    request = FormFactorRequest(source="cornell-box", bundles=passes * _BUNDLES, max_area=_AREA)
    work = FormFactorWork(request, None)
    work.cluster = cluster
    runner = work.runner()
    begin = time.perf_counter()
    runner.run()
    return time.perf_counter() - begin


def alone_seconds(name: str, passes: int) -> float:
    """Seconds of passes in this process."""
    if name == LINES:
        use_variant("llvm_ad_rgb")
        set_threads(1)
        return _lines(passes)
    task, problem = _task(name, passes), _problem()
    begin = time.perf_counter()
    method = task.method(task.method.Settings(samples_per_pass=1))
    method.prepare(problem, 0)
    Job(problem, method, seed=0, budget=task.budget, place={}).runner().run()
    return time.perf_counter() - begin


def cluster_seconds(cluster: Cluster, name: str, passes: int) -> float:
    """Seconds of passes on a cluster."""
    if name == LINES:
        return _lines(passes, cluster)
    job = _job(name)
    job.budget = Budget(iterations=passes)
    runner = job.runner(executor=cluster.rendering(job))
    begin = time.perf_counter()
    runner.run()
    return time.perf_counter() - begin


@cache
def _job(name: str) -> Job:
    return Job.open(_task(name, 1))
