"""The film's filter: what it costs a pass, and what edges look like after few samples."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import mitsuba as mi
import numpy as np
import typer

from etendue import methods, scene
from etendue.core import OptionError, Replica
from etendue.scene import Problem, bundled

from .measuring import Clock, Record, interleaved, verdict
from .mitsuba_pictures import picture
from .options import Methods, Pixels, Rounds, Seeds

#: A pass with a Gaussian, relative to one with a box.
COST_BAR = 1.05
_KINDS = ("box", "tent", "gaussian", "lanczos")
_SAMPLES = (1, 4, 16)
#: Ways to render: settings of ``path``; none is Mitsuba's ``path``.
_WAYS: dict[str, dict[str, str] | None] = {
    "Mitsuba": None,
    "shared": {},
    "shared, sampler=independent": {"sampler": "independent"},
    "reconstruction=independent": {"reconstruction": "independent"},
}


def measure(
    part: Annotated[str, typer.Option(help="cost or edges; both by default.")] = "",
    chosen: Methods = "path,bpt,vcm,sppm,light",
    pixels: Pixels = 65536,
    rounds: Rounds = 11,
    seeds: Seeds = 32,
) -> Iterator[Record]:
    """Cost of a pass by filter, errors of edges."""
    if part not in ("", "cost", "edges"):
        raise OptionError(f"--part is cost or edges, not '{part}'")
    if part in ("", "cost"):
        yield cost(chosen, round(pixels**0.5), rounds)
    if part in ("", "edges"):
        yield edges(seeds)


def cost(names: Sequence[str], side: int, rounds: int) -> Record:
    """CPU time of a pass with each filter, relative to the box in the same round."""
    record = Record(
        f"Cost of a pass by filter, cornell-box {side}x{side}", ("", "samples", *_KINDS, "bar for gaussian")
    )
    for name in names:
        tasks: dict[str, Any] = {}
        method = methods.get(name)
        for kind in _KINDS:
            source = bundled()["cornell-box"].build()
            source["sensor"]["film"] |= {"rfilter": {"type": kind}}
            prepared = method()
            prepared.prepare(scene.load(source, size=(side, side)), 0)
            tasks[kind] = Replica(prepared, 0).step
        clocks = interleaved(tasks, rounds, 1)
        cells, ratio = [], 1.0
        for kind in _KINDS:
            ratios = [clock.cpu / box.cpu for clock, box in zip(clocks[kind], clocks["box"], strict=True)]
            middle = statistics.median(ratios)
            ratio = middle if kind == "gaussian" else ratio
            cells.append(_box(clocks["box"]) if kind == "box" else f"{middle:.3f} ± {_error(ratios):.3f}")
        record.add(name, str(prepared.samples_per_iteration), *cells, verdict(ratio, COST_BAR))
    record.notes.append(
        f"CPU seconds of a pass with a box, and ratios to it: passes in turn, median of {rounds} rounds after 1"
    )
    return record


def _box(clocks: Sequence[Clock]) -> str:
    return f"{statistics.median(clock.cpu for clock in clocks):.2f} s"


def _error(values: Sequence[float]) -> float:
    """Standard error of the median of about normal values."""
    return 1.25 * statistics.stdev(values) / len(values) ** 0.5


def edges(seeds: int) -> Record:
    """Errors of the pixels on the edge of a bright rectangle on black, alone and as a mean along the edge."""
    record = Record(
        "Edge of a bright rectangle, error of its pixels / of their mean, relative to its radiance",
        ("edge", "filter", "samples", *_WAYS),
    )
    for what, angle in (("along pixels", 0.0), ("turned by 7 degrees", 7.0)):
        for kind in ("tent", "gaussian"):
            problem = _rectangle(angle, kind)
            truth = picture(problem, 4711, samples=8192, part=1024)[0][..., 0]
            on_edge = (truth > 0.02) & (truth < 0.98)
            for samples in _SAMPLES:
                cells = []
                for settings in _WAYS.values():
                    errors = [
                        _picture(problem, samples, seed, settings)[on_edge] - truth[on_edge] for seed in range(seeds)
                    ]
                    alone = np.sqrt(np.mean(np.square(errors)))
                    cells.append(f"{alone:.3f} / {np.sqrt(np.mean(np.square(np.mean(errors, axis=1)))):.4f}")
                record.add(what, kind, str(samples), *cells)
    record.notes.append(
        f"root mean squares over {seeds} seeds; 48x48 pixels; reference: Mitsuba's path, 8192 samples; shared: all "
        "pixels have the same offsets, by Owen's points or independent within a pass of one sample"
    )
    return record


def _rectangle(angle: float, kind: str) -> Problem:
    """A bright rectangle, off the centre, that fills a part of the film."""
    transform = mi.ScalarTransform4f()
    place = transform.translate([0.113, -0.071, 0.0]).rotate([0, 0, 1], angle).scale([0.5, 0.4, 1.0])
    return scene.load(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": transform.look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": kind}},
                "sampler": {"type": "independent"},
            },
            "integrator": {"type": "path", "max_depth": 1},
            "screen": {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": 1.0}},
        }
    )


def _picture(problem: Problem, samples: int, seed: int, settings: dict[str, str] | None) -> np.ndarray:
    if settings is None:
        return picture(problem, seed, samples=samples, part=samples)[0][..., 0]
    method = methods.get("path")
    path = method(method.Settings(max_depth=1, samples_per_pass=1, **settings))
    path.prepare(problem, seed)
    replica = Replica(path, seed)
    total = replica.step(0)
    for iteration in range(1, samples):
        total += replica.step(iteration)
    image: np.ndarray = replica.develop(total).image[..., 0]
    return image
