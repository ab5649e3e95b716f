"""What layers cost: CPU time of a pass with first hits or components, relative to one without."""

from __future__ import annotations

import statistics
from typing import Annotated, Any

import typer

from etendue import methods, scene
from etendue.core import Replica

from .measuring import Record, interleaved, spread, verdict
from .options import Methods, Names, Rounds, Size, WarmUp

#: A pass with first hits, relative to one without.
BAR, BAR_SIZE = 1.1, (256, 256)
_LAYERS: dict[str, dict[str, Any]] = {
    "none": {},
    "aovs": {"aovs": True},
    "components": {"components": True},
    "both": {"aovs": True, "components": True},
}


def measure(
    chosen: Methods = "path,bpt,vcm",
    scenes: Names = "cornell-box,cornell-glass",
    size: Size = "256x256",
    rounds: Rounds = 11,
    warm_up: WarmUp = 2,
    rfilter: Annotated[str, typer.Option(help="Reconstruction filter of the film, if not the scene's.")] = "",
) -> Record:
    """Passes in turn, with the methods' own settings and the scene's depth."""
    record = Record(
        f"Cost of layers, {size[0]}x{size[1]}{', filter ' + rfilter if rfilter else ''}",
        ("scene", "method", "samples", "CPU s", "aovs", "components", "both", "bar for aovs"),
    )
    for source in scenes:
        for name in chosen:
            tasks: dict[str, Any] = {}
            problem = scene.load(_with_filter(source, rfilter), size=size)
            for what, settings in _LAYERS.items():
                prepared = methods.get(name)(methods.get(name).Settings(max_depth=problem.max_depth, **settings))
                prepared.prepare(problem, 0)
                tasks[what] = Replica(prepared, 0).step
            clocks = interleaved(tasks, rounds, warm_up)
            plain = clocks.pop("none")
            ratios = {k: [a.cpu / b.cpu for a, b in zip(v, plain, strict=True)] for k, v in clocks.items()}
            bar = verdict(statistics.median(ratios["aovs"]), BAR) if tuple(size) == BAR_SIZE else ""
            cells = [f"{statistics.median(c.cpu for c in plain):.3f}", *(spread(r, ".3f") for r in ratios.values())]
            record.add(source, name, str(prepared.samples_per_iteration), *cells, bar)
    record.notes.append(
        f"CPU seconds of a pass, and ratios of CPU times to the pass without layers of the same round: median (min … "
        f"max) of {rounds} rounds after {warm_up} to warm up; a pass ends with its sums on the host"
    )
    return record


def _with_filter(source: str, rfilter: str) -> Any:
    """The scene, or a bundled scene with a filter."""
    if not rfilter:
        return source
    described = scene.bundled()[source].build()
    described["sensor"]["film"] |= {"rfilter": {"type": rfilter}}
    return described
