"""Profile (tables 5.3 and 5.4 of the thesis): what a pass of VCM is made of, on each scene."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from etendue.core import Replica

from ..measuring import Record, interleaved
from ..options import Rounds, Seconds, Size, WarmUp
from ..racing import Entrant
from .entrants import RADIUS, ROULETTE, merging, open_scene
from .options import ALL, SIZE, Roulette, Scenes


def measure(
    names: Scenes = ALL,
    size: Size = SIZE,
    seconds: Seconds = 60.0,
    rounds: Rounds = 9,
    warm_up: WarmUp = 2,
    roulettes: Roulette = "albedo,throughput",
) -> Record:
    """A row for each scene and roulette. ``seconds``: the time that the passes are counted for."""
    record = Record(
        f"Profile of VCM, {size[0]}x{size[1]}",
        (
            "",
            f"passes in {seconds:g} s",
            "pass s",
            "light pass s",
            "grid s",
            "merging s",
            "light path",
            "camera path",
            "connections",
            "photons M",
            "Mrays/s",
        ),
    )
    for name in names:
        for roulette in roulettes:
            record.add(
                f"{name}, roulette by {roulette}", *_row(name, size, seconds, rounds, warm_up, ROULETTE[roulette])
            )
    record.notes += [
        f"median of {rounds} rounds after {warm_up}, one sample a pixel; radius {1000 * RADIUS:g} mm, settings of the "
        "thesis, no merging at the first camera vertex",
        "light pass and grid: times of their kernels in one pass; merging: pass with it minus pass without it, in turn "
        "(the kernels are fused), so the grid is part of it",
        "light path, camera path: mean number of surfaces that a path meets; connections: mean number of pairs of a "
        "stored light vertex and a camera vertex that takes connections, for a sample; photons: stored in a pass",
    ]
    return record


def _row(
    name: str, size: tuple[int, int], seconds: float, rounds: int, warm_up: int, roulette: Mapping[str, Any]
) -> list[str]:
    problem = open_scene(name, size)
    settings = merging("vcm", merge_first=False, samples_per_pass=1, **roulette)
    full = Replica(Entrant("vcm", "vcm", settings).prepared(problem, 0), 0)
    bare = Replica(Entrant("without", "vcm", settings | {"merging": False}).prepared(problem, 0), 0)
    rays = []

    def whole(number: int) -> None:
        rays.append(full.step(number).counters["rays"])

    times = interleaved({"full": whole, "bare": bare.step}, rounds, warm_up)
    wall = {key: [clock.wall for clock in clocks] for key, clocks in times.items()}
    a_pass = statistics.median(wall["full"])
    merge = statistics.median(a - b for a, b in zip(wall["full"], wall["bare"], strict=True))
    light, grid = _kernels(full)
    counters = full.step(0).counters
    pixels = size[0] * size[1]
    light_length, camera_length, camera_ends = _lengths(problem, size, roulette)
    photons = counters["light_vertices"]
    return [
        f"{seconds / a_pass:.0f}",
        f"{a_pass:.3f}",
        f"{light:.3f}",
        f"{grid:.3f}",
        f"{merge:.3f}",
        f"{light_length:.2f}",
        f"{camera_length:.2f}",
        f"{photons / pixels * camera_ends:.1f}",
        f"{photons / 1e6:.3f}",
        f"{statistics.fmean(rays) / a_pass / 1e6:.2f}",
    ]


def _kernels(replica: Replica) -> tuple[float, float]:
    """Seconds of the light walk, and of what is launched between it and the camera walk: the grid.

    The two walks are the kernels with the most operations.
    """
    import drjit as dr

    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        replica.step(1)
        launched = dr.kernel_history()
    size = [kernel.get("operation_count") or 0 for kernel in launched]
    first, second = sorted(sorted(range(len(size)), key=lambda k: -size[k])[:2])
    spent = [float(kernel["execution_time"]) / 1000.0 for kernel in launched]
    return spent[first], sum(spent[first + 1 : second])


def _lengths(problem: Any, size: tuple[int, int], roulette: Mapping[str, Any]) -> tuple[float, float, float]:
    """Means over the paths of a pass: surfaces of a light path, surfaces of a camera path, and those of the latter that
    take connections.

    The camera paths are walked again; a pass that only merges casts the rays of both walks and no others.
    """
    merger = Entrant("bpm", "bpm", merging("bpm", samples_per_pass=1, **roulette)).prepared(problem, 0)
    edges, met, ends = _camera_walk(merger)
    pixels = size[0] * size[1]
    # In a closed scene every edge ends on a surface.
    return Replica(merger, 0).step(0).counters["rays"] / pixels - edges, met, ends


def _camera_walk(estimator: Any) -> tuple[float, float, float]:
    """Means over the camera paths of the first pass: edges, surfaces met, surfaces that take connections."""
    import drjit as dr
    import numpy as np

    from etendue.transport import CameraPath, CameraWalk, Walker, ones

    # Dr.Jit looks for the types of its members among the names of this module.
    @dataclass(kw_only=True)
    class Counted(CameraPath):
        met: mi.UInt32
        ends: mi.UInt32

    lanes = dr.arange(mi.UInt32, estimator.camera.pixels)
    source = estimator.camera_numbers(lanes, 1, 0, 0)
    ray, _, _ = estimator.camera.primary(lanes, source)
    by_albedo = estimator.settings.roulette == "albedo"
    walker = estimator.walker(Walker, survival=CameraWalk.survival, by_albedo=by_albedo)  # the roulette of the pass

    def edge(s: Counted) -> Counted:
        vertex = walker.arrive(s)
        s.active &= vertex.valid
        s.ends = s.ends + ones(s.active & vertex.smooth)
        scattered, _ = vertex.sample(source, s.active)
        s.met = s.met + ones(s.active & ~scattered.is_null)
        walker.advance(s, vertex, scattered, source)
        return s

    path = Counted.start(ray, walker.max_edges, met=mi.UInt32(0), ends=mi.UInt32(0))
    path = walker.walk(path, edge, "camera lengths")
    depth, met, ends = path.depth, path.met, path.ends
    dr.eval(depth, met, ends)
    return float(np.asarray(depth).mean()) - 1.0, float(np.asarray(met).mean()), float(np.asarray(ends).mean())
