"""What worker processes cost and bring: one beside a process of its own, two beside two that know nothing of each
other. Each row is saved when it is measured, so that a table can be resumed."""

from __future__ import annotations

import json
import multiprocessing
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer

from etendue import methods
from etendue.core import set_threads, use_variant
from etendue.distributed import Cluster, ProcessPool
from etendue.engine import Budget, Job, Task
from etendue.products import Picture, picture_task
from etendue.products.patches import AtOnce, FactorRun
from etendue.scene import SceneSource

from .measuring import Record, console, spread, verdict
from .options import Methods, Out, Rounds

#: Time of a worker of the cluster relative to a process alone, and throughput of two relative to two alone.
OVERHEAD_BAR, EFFICIENCY_BAR = 1.05, 0.95
_SIZE = (256, 256)
#: What else is measured: lines through a room by the A-buffer, whose passes are divided by their directions.
LINES, _BUNDLES, _AREA = "a-buffer", 8, 4e-3
#: Settings of all methods, and of those that prepare for longer than a run takes.
_SETTINGS, _OWN = {"samples_per_pass": 1}, {"pssmlt": {"bootstrap": 1 << 14}, "mmlt": {"bootstrap": 1 << 14}}
#: Passes by which kernels are compiled, and by which the seconds of a pass are measured.
_FEW = 4


@dataclass
class _Row:
    """Ratios of each round."""

    passes: int
    costs: list[float]  #: one worker over one process
    gains: list[float]  #: two processes over two workers
    seconds: list[float]  #: of the process alone


def measure(
    chosen: Methods = "bpt,vcm,pssmlt",
    lines: Annotated[bool, typer.Option("--lines/--no-lines", help="Also form factors by the A-buffer.")] = True,
    time_: Annotated[float, typer.Option("--time", help="Seconds of a run, about.", metavar="SECONDS")] = 4.0,
    rounds: Rounds = 3,
    out: Out = Path("workers-output"),
) -> Iterator[Record]:
    """Seconds of passes in processes of one thread: alone, and as workers of a cluster."""
    out.mkdir(parents=True, exist_ok=True)
    saved = out / "rows.jsonl"
    record = Record(
        "Worker processes of one thread, cornell-glass 256x256, and form factors of cornell-box",
        ("", "passes", "one alone s", "one worker / one alone", "bar", "two alone / two workers", "bar"),
    )
    with ExitStack() as stack:
        crews: list[_Crews] = []

        def crew() -> _Crews:
            crews[:] = crews or [_Crews(stack)]
            return crews[0]

        for name in [*chosen, LINES] if lines else chosen:
            row = _saved(saved, [name, time_, rounds], lambda name=name: crew().row(name, time_, rounds))  # type: ignore[misc]
            gain = statistics.median(row.gains)
            record.add(
                name,
                str(row.passes),
                f"{statistics.median(row.seconds):.1f}",
                spread(row.costs, ".3f"),
                verdict(statistics.median(row.costs), OVERHEAD_BAR),
                spread(row.gains, ".3f"),
                f"≥ {EFFICIENCY_BAR:g}: {'reached' if gain >= EFFICIENCY_BAR else 'missed'}",
            )
    record.notes.append(
        "Wall seconds with preparation of the method, processes and scenes kept, in turn, "
        f"{rounds} rounds after one to compile: median (least … most)"
    )
    record.notes.append("two workers make the passes that both processes make; those of pssmlt and mmlt are replicas")
    yield record
    saved.unlink()  # the table is complete: the next call measures anew


def _saved(path: Path, key: Sequence[Any], make: Callable[[], _Row]) -> _Row:
    """A row, or what an earlier call that was interrupted has saved of it."""
    for line in path.read_text("utf-8").splitlines() if path.exists() else ():
        if (known := json.loads(line))["key"] == list(key):
            return _Row(**known["row"])
    begin = time.perf_counter()
    row = make()
    console.print(
        f"{key[0]}: one worker / one alone {spread(row.costs, '.3f')}, two alone / two workers "
        f"{spread(row.gains, '.3f')}, {time.perf_counter() - begin:.0f} s",
        style="dim",
    )
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"key": list(key), "row": vars(row)}) + "\n")
    return row


class _Crews:
    """A cluster of one worker, one of two, and two processes alone; they end with ``stack``."""

    def __init__(self, stack: ExitStack) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._one = stack.enter_context(Cluster(ProcessPool(1, threads=1)))
        self._two = stack.enter_context(Cluster(ProcessPool(2, threads=1)))
        self._alone = [stack.enter_context(ProcessPoolExecutor(1, spawn)) for _ in range(2)]

    def row(self, name: str, seconds: float, rounds: int) -> _Row:
        """Measure in turn."""
        self._apart(name, _FEW)  # compiles
        for cluster in (self._one, self._two):
            cluster_seconds(cluster, name, 2 * _FEW)
        few, many = self._mine(name, _FEW), self._mine(name, 3 * _FEW)
        pace = max((many - few) / (2 * _FEW), 0.1 * many / _FEW)  # without preparation, which may take as long
        row = _Row(max(_FEW, round(seconds / pace)), [], [], [])
        for _ in range(rounds):
            row.seconds.append(self._mine(name, row.passes))
            row.costs.append(cluster_seconds(self._one, name, row.passes) / row.seconds[-1])
            row.gains.append(self._apart(name, row.passes) / cluster_seconds(self._two, name, 2 * row.passes))
        return row

    def _mine(self, name: str, passes: int) -> float:
        return self._alone[0].submit(alone_seconds, name, passes).result()

    def _apart(self, name: str, passes: int) -> float:
        """Both begin when both are ready, and the later one counts."""
        begin = time.perf_counter()
        for future in [process.submit(alone_seconds, name, passes) for process in self._alone]:
            future.result()
        return time.perf_counter() - begin


def _task(name: str, passes: int) -> Task:
    source, settings = SceneSource("cornell-glass", _SIZE), _SETTINGS | _OWN.get(name, {})
    return picture_task(source, methods.get(name), Picture(), settings, 0, Budget(iterations=passes))


@cache
def _problem() -> Any:
    use_variant("llvm_ad_rgb")
    set_threads(1)
    return Job.open(_task("path", 1)).problem


def _job(name: str, passes: int) -> Job:
    """A prepared job in the scene of this process."""
    task, problem = _task(name, passes), _problem()
    method = task.method(task.method.Settings.from_mapping(task.settings))
    method.prepare(problem, task.seed)
    return Job(task, problem, method, task.budget)


def _casting(passes: int) -> Job:
    task = FactorRun(source="cornell-box", limits={"bundles": passes * _BUNDLES}, max_area=_AREA).task()
    assert not isinstance(task, AtOnce)
    return Job.open(task)


def alone_seconds(name: str, passes: int) -> float:
    """Seconds of passes in this process."""
    use_variant("llvm_ad_rgb")
    set_threads(1)
    if name == LINES:
        job = _casting(passes)
        begin = time.perf_counter()
        job.runner().run()
    else:
        _problem()
        begin = time.perf_counter()
        _job(name, passes).runner().run()
    return time.perf_counter() - begin


def cluster_seconds(cluster: Cluster, name: str, passes: int) -> float:
    """Seconds of passes on a cluster, whose workers prepare the method."""
    job = _casting(passes) if name == LINES else _job(name, passes)
    runner = job.runner(cluster.executor(job))
    begin = time.perf_counter()
    runner.run()
    return time.perf_counter() - begin
