"""Experiment E3 of the thesis on the processes of this machine, beside its simulation."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Annotated, Any

import psutil
import typer

from etendue import methods
from etendue.core import ClusterError
from etendue.distributed import Cluster, ProcessPool
from etendue.engine import Budget, Job, Runner, Task
from etendue.products import Picture, picture_task
from etendue.products.particles import ParticleProduct
from etendue.scene import SceneSource

from ..measuring import Record, spread
from ..options import Rounds, whole_numbers
from .scaling import fit_amdahl
from .simulated import Site, simulate

#: Size of the thesis's pictures of the sitting room, and light paths of a pass in its office.
_SIZE, _PATHS = (256, 183), 1 << 15
#: Bytes of a sum of the picture; of a particle, and particles of a light path, about.
_PICTURE, _PARTICLE, _HITS = 256 * 183 * 3 * 4 * 2.0, 60.0, 4.0
Workers = Annotated[
    Any, typer.Option("--workers", parser=whole_numbers, help="Numbers of processes, from 1 on.", metavar="N,...")
]


@dataclass
class _Run:
    wall: float
    workers: float  #: CPU seconds of all
    client: float  #: CPU seconds
    least: float  #: CPU time of the worker with the least, to the mean


def measure(
    workers: Workers = "1,2",
    passes: Annotated[int, typer.Option(min=4, help="Passes of a run.")] = 48,
    rounds: Rounds = 3,
) -> Iterator[Record]:
    """A table of each kind: runs with the numbers of workers in turn."""
    if workers[0] != 1:
        raise ClusterError(f"speed-up is relative to one worker: begin with 1, not {workers[0]}")
    kinds: dict[str, tuple[Callable[[Cluster], Runner], float]] = {
        "view dependent, sitting-room": (lambda cluster: _picture(cluster, passes), _PICTURE),
        "particles, diffuse-office": (lambda cluster: _particles(cluster, passes), _PARTICLE * _HITS * _PATHS),
    }
    with ExitStack() as stack:
        crews = {n: stack.enter_context(Cluster(ProcessPool(n, threads=1))) for n in workers}
        for kind, (make, size) in kinds.items():
            runs: dict[int, list[_Run]] = {n: [] for n in workers}
            for number in range(rounds + 1):
                for n, cluster in crews.items():
                    made = _run(make(cluster), n)
                    if number:  # the first round loads and compiles
                        runs[n].append(made)
            yield _table(kind, runs, passes, size)


def _picture(cluster: Cluster, passes: int) -> Runner:
    source, budget = SceneSource("sitting-room", _SIZE), Budget(iterations=passes)
    task = picture_task(source, methods.get("path"), Picture(), {"samples_per_pass": 4}, 0, budget)
    return _runner(task, cluster)


def _particles(cluster: Cluster, passes: int) -> Runner:
    source, settings = SceneSource("diffuse-office"), {"samples_per_pass": _PATHS}
    budget = Budget(samples=passes * _PATHS)
    return _runner(Task(source, methods.ParticleTracing, ParticleProduct(), settings, 0, budget), cluster)


def _runner(task: Task, cluster: Cluster) -> Runner:
    job = Job.open(task)
    return job.runner(job.product.divided(job, cluster))


def _run(runner: Runner, count: int) -> _Run:
    before, own, begin = _cpu(), time.process_time(), time.perf_counter()
    runner.run()
    wall, client = time.perf_counter() - begin, time.process_time() - own
    spent = sorted((now - before.get(pid, 0.0) for pid, now in _cpu().items()), reverse=True)[:count]
    return _Run(wall, sum(spent), client, spent[-1] / statistics.mean(spent))


def _cpu() -> dict[int, float]:
    """CPU seconds of the processes that this one has started; those of idle workers do not change."""
    found = {}
    for process in psutil.Process().children(recursive=True):
        try:
            found[process.pid] = sum(process.cpu_times()[:2])
        except psutil.NoSuchProcess:
            continue
    return found


def _table(kind: str, runs: dict[int, list[_Run]], passes: int, size: float) -> Record:
    record = Record(
        f"Processes of one machine, {kind}, {passes} passes, sums of {1e-6 * size:.1f} MB",
        ("workers", "wall s", "speed-up", "CPU s of workers", "of client", "by CPU time", "simulated", "least worker"),
    )
    one = runs[1]
    each = statistics.median(run.workers for run in one) / passes
    by_cpu, simulated, first = {}, {}, 0.0
    for n, those in runs.items():
        work, client, least = (
            statistics.median(getattr(run, name) for run in those) for name in ("workers", "client", "least")
        )
        site = Site(n, each, size, first_seconds=0.0, spread=0.0, stragglers=0.0, losses=0.0)
        seconds = simulate(site, passes, "demand", 0).seconds
        first = first or seconds
        simulated[n] = first / seconds
        by_cpu[n] = statistics.median(
            (a.workers + a.client) / (b.workers / n + b.client) for a, b in zip(one, those, strict=True)
        )
        gains = [a.wall / b.wall for a, b in zip(one, those, strict=True)]
        wall = statistics.median(run.wall for run in those)
        record.add(
            str(n),
            f"{wall:.1f}",
            spread(gains, ".2f"),
            f"{work:.1f}",
            f"{client:.2f}",
            f"{by_cpu[n]:.2f}",
            f"{simulated[n]:.2f}",
            f"{least:.2f}",
        )
    if len(runs) > 1:
        fits = [f"{label} {fit_amdahl(v)[0]:.4f}" for label, v in (("by CPU time", by_cpu), ("simulated", simulated))]
        record.notes.append(f"Amdahl's serial share: {', '.join(fits)}")
    record.notes += [
        f"{len(one)} rounds in turn after one that loads and compiles: median (least … most); workers of one thread on "
        f"{os.cpu_count()} cores; load {os.getloadavg()[0]:.1f}, so wall times are those of a shared machine",
        "by CPU time: the speed-up if each worker had a core, the client another, and it worked while no worker does: "
        "CPU time of workers and client with one worker, over that of n workers divided by n and of the client; "
        "simulated: a pass of the same CPU time, a sum of the same size; least worker: its CPU time to the mean",
    ]
    return record
