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

from .measuring import Clock, Record, console, interleaved, verdict
from .mitsuba_pictures import picture
from .options import Methods, Pixels, Rounds, Seeds

#: A pass with a Gaussian, relative to one with a box.
COST_BAR = 1.05
_KINDS = ("box", "tent", "gaussian", "lanczos")
_SAMPLES = (1, 4, 16)
#: Pixels of the picture of an edge along each side, and points of its reference in a pixel along each side.
_SIDE, _POINTS = 48, 64
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
            truth = _exact(problem)
            on_edge = (truth > 0.02) & (truth < 0.98)
            for samples in _SAMPLES:
                cells = []
                for settings in _WAYS.values():
                    errors = [image[on_edge] - truth[on_edge] for image in _pictures(problem, samples, seeds, settings)]
                    alone, mean = (np.sqrt(np.mean(np.square(e))) for e in (errors, np.mean(errors, axis=1)))
                    cells.append(f"{alone:.3f} / {mean:.4f}")
                record.add(what, kind, str(samples), *cells)
                console.print("  ".join([what, kind, str(samples), *cells]), style="dim")
    record.notes.append(
        f"root mean squares over {seeds} seeds; {_SIDE}x{_SIDE} pixels, all samples in one pass; reference: "
        f"{_POINTS}x{_POINTS} rays a pixel; shared: all pixels have the same offsets"
    )
    return record


def _exact(problem: Problem) -> np.ndarray:
    """The rectangle, jittered in cells much finer than pixels, times the film's filter."""
    count = _SIDE * _POINTS
    rng = np.random.default_rng(5)
    y, x = ((np.indices((count, count)) + rng.random((2, count, count))) / count).astype(np.float32)
    place = mi.Point2f(x.ravel(), y.ravel())
    rays, _ = problem.sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    seen = np.asarray(problem.scene.ray_intersect_preliminary(rays).is_valid()).reshape(count, count)
    offset = (np.arange(count) + 0.5)[None, :] / _POINTS - np.arange(_SIDE)[:, None] - 0.5
    rfilter = problem.sensor.film().rfilter()
    weights = np.where(
        np.abs(offset) < rfilter.radius(), np.asarray(rfilter.eval(mi.Float(offset.ravel()))).reshape(offset.shape), 0
    )
    weights /= weights.sum(axis=1, keepdims=True)
    image: np.ndarray = weights @ seen @ weights.T
    return image


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
                "film": {"type": "hdrfilm", "width": _SIDE, "height": _SIDE, "rfilter": {"type": kind}},
                "sampler": {"type": "independent"},
            },
            "integrator": {"type": "path", "max_depth": 1},
            "screen": {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": 1.0}},
        }
    )


def _pictures(problem: Problem, samples: int, seeds: int, settings: dict[str, str] | None) -> Iterator[np.ndarray]:
    """One picture a seed, (height, width)."""
    if settings is None:
        for seed in range(seeds):
            yield picture(problem, seed, spp=samples, part=samples)[0][..., 0]
        return
    method = methods.get("path")
    path = method(method.Settings(max_depth=1, samples_per_pass=samples, **settings))
    path.prepare(problem, 0)
    for seed in range(seeds):
        replica = Replica(path, seed)
        yield replica.develop(replica.step(0)).image[..., 0]
