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
from etendue.core import set_threads, use_variant
from etendue.distributed import Cluster, DaskPool
from etendue.engine import Budget, Job, Task

from .measuring import Record, spread, verdict
from .options import Methods, Rounds

#: Time of a worker of the cluster relative to a process alone, and throughput of two relative to two alone.
OVERHEAD_BAR, EFFICIENCY_BAR = 1.05, 0.95
_SIZE = (256, 256)


def measure(
    chosen: Methods = "path,bpt,vcm",
    time_: Annotated[float, typer.Option("--time", help="Seconds of a run, about.", metavar="SECONDS")] = 20.0,
    rounds: Rounds = 5,
) -> Record:
    """Seconds of passes in processes of one thread: alone, and as workers of a cluster."""
    record = Record(
        "Worker processes of one thread, cornell-glass 256x256",
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
        for name in chosen:
            few = 4
            for executor in alone:
                executor.submit(alone_seconds, name, few).result()
            pace = first.submit(alone_seconds, name, few).result() / few
            passes = max(few, round(time_ / pace))
            for cluster in (one, two):
                cluster_seconds(cluster, name, 16)
            costs, gains = [], []
            for _ in range(rounds):
                mine = first.submit(alone_seconds, name, passes).result()
                costs.append(cluster_seconds(one, name, passes) / mine)
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


def alone_seconds(name: str, passes: int) -> float:
    """Seconds of passes in this process."""
    task, problem = _task(name, passes), _problem()
    begin = time.perf_counter()
    method = task.method(task.method.Settings(samples_per_pass=1))
    method.prepare(problem, 0)
    Job(problem, method, seed=0, budget=task.budget, place={}).runner().run()
    return time.perf_counter() - begin


def cluster_seconds(cluster: Cluster, name: str, passes: int) -> float:
    """Seconds of passes on a cluster."""
    job = _job(name)
    job.budget = Budget(iterations=passes)
    runner = job.runner(executor=cluster.rendering(job))
    begin = time.perf_counter()
    runner.run()
    return time.perf_counter() - begin


@cache
def _job(name: str) -> Job:
    return Job.open(_task(name, 1))
