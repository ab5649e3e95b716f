"""Light paths and the boxes of a scene: which they visit, what a cache would make of it, and what a divided scene
sends."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer

from etendue.distributed import Cluster, ProcessPool, Traffic
from etendue.engine import Budget, Job, Task
from etendue.methods import ParticleTracing
from etendue.particles import BoxGrid, Particles
from etendue.products import run_job
from etendue.products.particles import ParticleProduct
from etendue.scene import SceneSource, load, shape_boxes, unmerged

from ..measuring import Record
from .coherence import distinct_in_windows, lru_misses, visits

_WINDOW, _CACHES = 256, (4, 16, 64)


def coherence(
    paths: Annotated[int, typer.Option(min=1000)] = 100_000,
    cells: Annotated[int, typer.Option(min=2, help="Boxes along each axis.")] = 8,
) -> Record:
    """Figures 5.37 to 5.46: visits of boxes in the order of tracing, by random paths and by paths in strata."""
    record = Record(
        f"Visits of {cells}x{cells}x{cells} boxes by {paths} light paths",
        (
            "scene",
            "paths",
            "boxes",
            "largest share",
            f"different in {_WINDOW}",
            "/ random",
            *(f"misses, {c} kept" for c in _CACHES),
            "first hits, / random",
        ),
    )
    for scene in ("cornell-box", "caustics"):
        grid = BoxGrid.even(shape_boxes(load(scene, change=unmerged))[1], (cells, cells, cells))
        base: list[float] = []
        for name, sampler in (("random", "independent"), ("in strata", "strata")):
            particles = _traced(scene, paths, sampler)
            every, first = visits(particles, grid), visits(particles[particles.bounce == particles.bounce.min()], grid)
            found = [float(distinct_in_windows(boxes, _WINDOW).mean()) for boxes in (every, first)]
            base = base or found
            counts = np.bincount(every, minlength=len(grid))
            record.add(
                scene, name, str(np.count_nonzero(counts)), f"{counts.max() / len(every):.3f}", f"{found[0]:.1f}",
                f"{found[0] / base[0]:.2f}", *(f"{lru_misses(every, c) / len(every):.3f}" for c in _CACHES),
                f"{found[1] / base[1]:.2f}",
            )  # fmt: skip
    record.notes.append(
        "In strata: path v is in stratum v of the mixed-radix code of light, point, direction and first bounce; the "
        "bar: at most .5 of the random paths' different boxes in a window"
    )
    return record


def _traced(scene: str, paths: int, sampler: str) -> Particles:
    settings = {"sampler": sampler, "samples_per_pass": paths}
    task = Task(SceneSource(scene), ParticleTracing, ParticleProduct(), settings, budget=Budget(samples=paths))
    return run_job(lambda: Job.open(task)).particles


def divided(
    paths: Annotated[int, typer.Option(min=1000)] = 50_000,
    scene: Annotated[str, typer.Option(metavar="NAME")] = "cornell-box",
) -> Iterator[Record]:
    """A scene cut into boxes beside the whole one, in one process of one thread."""
    record = Record(
        f"{scene} in boxes, {paths} light paths, one worker of one thread",
        (
            "boxes",
            "shapes of a box",
            "seconds",
            "tasks",
            "loads",
            "records a path",
            "MB to workers",
            "MB back",
            "equal",
        ),
    )
    ids, bounds = shape_boxes(load(scene, change=unmerged))
    with Cluster(ProcessPool(1, threads=1)) as cluster:
        whole = _divided(cluster, scene, paths, None)[0]
        for boxes in ((1, 1, 1), (2, 1, 1), (2, 2, 1), (2, 2, 2)):
            grid = BoxGrid.even(bounds, boxes)
            _divided(cluster, scene, paths, boxes)  # compiles
            begin = time.perf_counter()
            particles, traffic = _divided(cluster, scene, paths, boxes)
            seconds = time.perf_counter() - begin
            same = all(np.array_equal(getattr(particles, f), getattr(whole, f)) for f in ("position", "power", "path"))
            carried = [visit for visit in traffic.visits if visit.box >= 0]
            shapes = np.mean([len(grid.touching(box, bounds)) for box in range(len(grid))])
            record.add(
                "x".join(map(str, boxes)), f"{shapes:.1f} of {len(ids)}", f"{seconds:.1f}", str(len(traffic.visits)),
                str(traffic.loads), f"{sum(v.paths for v in carried) / paths:.2f}", f"{traffic.sent / 1e6:.1f}",
                f"{traffic.received / 1e6:.1f}", str(same),
            )  # fmt: skip
    record.notes.append("equal: whether all particles are bit for bit those of the undivided scene")
    yield record


def _divided(cluster: Cluster, scene: str, paths: int, boxes: tuple[int, int, int] | None) -> tuple[Particles, Traffic]:
    source, settings = SceneSource(scene, merge=boxes is None), {"samples_per_pass": paths // 2}
    task = Task(source, ParticleTracing, ParticleProduct(boxes=boxes), settings, budget=Budget(samples=paths))
    made = run_job(lambda: Job.open(task), cluster=cluster)
    return made.particles, made.traffic
