"""How far clusters scale, and what limits them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
import typer

from ..measuring import Record
from ..options import whole_numbers
from .simulated import Outcome, Site, simulate

#: Pictures with squares for the noise in single precision, and seconds of a pass of a worker of 16 threads.
_PICTURES = {"256x256": (256 * 256, 0.05), "1920x1080": (1920 * 1080, 0.5), "3840x2160": (3840 * 2160, 2.0)}
_SCENE = 1e9


def _bytes(pixels: int, width: int = 4) -> float:
    return pixels * 3 * 2 * width


def measure(
    workers: Annotated[Any, typer.Option(parser=whole_numbers, metavar="N,...")] = "1,10,100,1000,10000",
    minutes: Annotated[float, typer.Option(help="Of a simulated run with workers that never wait.")] = 5.0,
) -> Iterator[Record]:
    """The executors' own policies under a simulated clock."""
    for name, (pixels, seconds) in _PICTURES.items():
        record = Record(
            f"Simulated cluster: {name}, passes of {seconds:g} s, scene of 1 GB",
            (
                "workers",
                "wall s",
                "efficiency",
                "without merging",
                "double",
                "scene s",
                "scene by the client",
                "client busy",
                "policies ms/task",
                "scheduler",
                "tasks",
                "merges",
                "lost work",
            ),
        )
        for count in workers:
            passes = max(count, round(count * 60 * minutes / seconds))
            passes = min(passes, (150 if count <= 1000 else 60) * count)
            site = Site(count, seconds, _bytes(pixels), _SCENE)
            made = simulate(site, passes)
            p = made.pool
            busy = (p.adding + p.deciding) / made.seconds
            # Others cost too much to simulate where they are known to be slower.
            small = count <= 1000
            alone = simulate(_but(site, merges=False), passes) if small else None
            double = simulate(_but(site, sum_bytes=_bytes(pixels, 8)), passes) if small else None
            client = f"{count * _SCENE / site.link:.0f}"
            record.add(
                str(count), f"{made.seconds:.0f}", f"{made.efficiency:.2f}", _efficiency(alone), _efficiency(double),
                f"{_first_scene(site):.0f}", client, f"{busy:.0%}", f"{1e3 * p.deciding / max(1, p.tasks):.2f}",
                f"{p.scheduling / made.seconds:.1%}", str(p.tasks), str(p._gathering.merges),
                f"{p.wasted / (count * made.seconds):.2%}",
            )  # fmt: skip
        record.notes.append(
            "efficiency: work of workers of mean speed over the time of all; without merging: every sum goes to the "
            "client; double: sums in double precision; scene: until all have it, from each other or from the client "
            "alone; client busy: adding and deciding, whose CPU time is measured while the library decides"
        )
        record.notes.append(
            "10 Gbit/s, 1 ms, 0.5 ms of scheduler a task, speeds spread by 10 %, 2 % of workers 4 times slower, a loss "
            "in 100 hours of a worker"
        )
        yield record


def _but(site: Site, **changes: Any) -> Site:
    from dataclasses import replace

    return replace(site, **changes)


def _efficiency(outcome: Outcome | None) -> str:
    return "" if outcome is None else f"{outcome.efficiency:.2f}"


def _first_scene(site: Site) -> float:
    """Seconds until all workers have the scene, if they take it from each other."""
    return float(np.ceil(np.log2(site.workers + 1)) * site.scene_bytes / site.link)


# -- experiment E3 -----------------------------------------------------------------------------------------------------


def schedules(
    passes: Annotated[int, typer.Option(min=100)] = 1600,
    seeds: Annotated[int, typer.Option(min=1)] = 3,
) -> Iterator[Record]:
    """Experiment E3 of the thesis: 1 to 16 processors, of which one is shared with somebody else."""
    counts = (1, 2, 4, 5, 8, 12, 16)
    kinds = {"view dependent": 256 * 183 * 3 * 4 * 2.0, "particles": 30e6}
    for kind, size in kinds.items():
        record = Record(
            f"Schedules, {kind}: {passes} passes of 0.25 s, sums of {size / 1e6:.1f} MB, processor 5 at half speed",
            (
                "schedule",
                *(f"speed-up {n}" for n in counts[1:]),
                "passes of no. 5 / mean",
                "tasks",
                "MB",
                "Amdahl s",
                "rms",
                "Gustafson s",
                "rms",
            ),
        )
        for schedule in ("static", "demand", "stealing", "demand, merged"):
            runs = {n: [_run(n, passes, size, schedule, seed) for seed in range(seeds)] for n in counts}
            single = np.mean([run.seconds for run in runs[1]])
            speed = {n: single / np.mean([run.seconds for run in runs[n]]) for n in counts}
            last = runs[16][0]
            share = last.shares.get("w00004", 0) / (passes / 16)
            weak = {n: _weak(n, passes // 16, size, schedule) for n in counts}
            amdahl, gustafson = fit_amdahl(speed), fit_gustafson(weak)
            record.add(
                schedule,
                *(f"{speed[n]:.2f}" for n in counts[1:]),
                f"{share:.2f}",
                str(last.pool.tasks),
                f"{last.pool.bytes / 1e6:.0f}",
                f"{amdahl[0]:.4f}", f"{amdahl[1]:.2f}", f"{gustafson[0]:.4f}", f"{gustafson[1]:.2f}",
            )  # fmt: skip
        record.notes.append(
            f"Mean of {seeds} seeds; one link of 100 Mbit/s. Amdahl: S = 1 / (s + (1 - s) / n); Gustafson, with passes "
            "in proportion to n: S = s + (1 - s) n; s by least squares, and the residual of S. Sums go to one place; "
            "merged: they are added among the processors first if that place does not keep up, as in runs."
        )
        yield record


def _site(count: int, size: float) -> Site:
    return Site(
        count, 0.25, size, link=1.25e7, first_seconds=0.0, spread=0.0, stragglers=0.0, losses=0.0, slow=2.0,
        slow_ones=(4,), merges=False,
    )  # fmt: skip


def _run(count: int, passes: int, size: float, schedule: str, seed: int = 0) -> Outcome:
    name, _, merged = schedule.partition(", ")
    return simulate(_but(_site(count, size), merges=bool(merged)), passes, name, seed)


def _weak(count: int, passes: int, size: float, schedule: str) -> float:
    """Speed-up if the work grows with the processors."""
    one = _run(1, passes, size, schedule).seconds
    return count * one / _run(count, passes * count, size, schedule).seconds


def fit_amdahl(speed: dict[int, float]) -> tuple[float, float]:
    """(serial share s, rms residual of the speed-up) of S = 1 / (s + (1 - s) / n)."""
    n, wanted = np.array(list(speed)), np.array(list(speed.values()))
    x, y = 1.0 - 1.0 / n, 1.0 / wanted - 1.0 / n  # 1/S - 1/n = s (1 - 1/n)
    s = float(x @ y / (x @ x))
    return s, _rms(wanted, 1.0 / (s + (1.0 - s) / n))


def fit_gustafson(speed: dict[int, float]) -> tuple[float, float]:
    """(serial share s, rms residual of the speed-up) of S = s + (1 - s) n."""
    n, wanted = np.array(list(speed)), np.array(list(speed.values()))
    x = 1.0 - n
    s = float(x @ (wanted - n) / (x @ x))
    return s, _rms(wanted, s + (1.0 - s) * n)


def _rms(a: Sequence[float] | np.ndarray, b: Sequence[float] | np.ndarray) -> float:
    return float(np.sqrt(np.mean((np.asarray(a) - np.asarray(b)) ** 2)))
