"""Error in participating media after a given time, beside that of Mitsuba's ``volpath`` or ``volpathmis``."""

from __future__ import annotations

import gc
import statistics
from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue import render, scene
from etendue.film import relative_mse

from .measuring import Record, console, verdict
from .mitsuba_pictures import picture
from .options import Names, Seconds, Seeds, Size

#: Methods, and the least gain asked of each where a scene has a bar: error times time over that of another row.
METHODS = ("path", "bpt", "vcm", "auto")
BARS = {("room", "path"): ("volpath", 0.6), ("shade", "bpt"): ("path", 0.6), ("smoke", "vcm"): ("volpathmis", 0.05)}
#: Mitsuba's integrator by scene, ``volpath`` in others.
THEIRS = {"smoke": "volpathmis"}
#: Times the time of a picture for each half of the reference, the method of the halves, and the share of the largest
#: errors that is left out.
_HALF, _TRIM = 4.0, 0.001
_FOG = {"type": "ref", "id": "fog"}


def measure(
    names: Names = "room,shade,caustic,fog,aquarium,smoke",
    size: Size = "192x192",
    seconds: Seconds = 30.0,
    seeds: Seeds = 1,
) -> Iterator[Record]:
    """One table a scene; the methods take turns, seed by seed."""
    for name in names:
        source = SCENES[name]() if name in SCENES else name
        yield _record(name, source, size, seconds, seeds)


def _record(name: str, source: Any, size: tuple[int, int], seconds: float, seeds: int) -> Record:
    by, theirs = "bpt" if name == "room" else "vcm", THEIRS.get(name, "volpath")
    methods = (theirs, *METHODS)
    glass = _seen_through_glass(source, size)
    halves = [render(source, by, seconds=_HALF * seconds, size=size, seed=1000 + half).image for half in range(2)]
    reference = (halves[0] + halves[1]) / 2
    own = relative_mse(halves[0], reference, trim=_TRIM)
    cost: dict[str, list[float]] = {method: [] for method in methods}
    found: dict[str, list[tuple[float, ...]]] = {method: [] for method in methods}
    for seed in range(seeds):
        for method in methods:
            gc.collect()  # a scene that is still alive makes the next one's kernels larger
            image, samples, taken = _taken(source, method, size, seconds, seed)
            error = max(relative_mse(image, reference, trim=_TRIM) - own, 0.0)
            parts = [_error_in(part, image, reference, halves[0]) for part in (~glass, glass)]
            found[method].append((relative_mse(image, reference), error, *parts, samples))
            cost[method].append(error * taken)
            console.print(f"{name}, {method}, seed {seed}: {error:.4g} after {taken:.1f} s", style="dim")
    record = Record(
        f"Media, {name}, {size[0]}x{size[1]}, {seconds:g} s",
        (
            "",
            "relMSE",
            "without worst 0.1 %",
            "beside glass",
            "through glass",
            "spp",
            f"error x time to {theirs}'s",
            "bar",
        ),
    )
    for method in methods:
        plain, *errors, samples = (statistics.median(column) for column in zip(*found[method], strict=True))
        against, most = BARS.get((name, method), (theirs, 0.0))
        ratios = {other: statistics.median(_over(cost[method], cost[other])) for other in (theirs, against)}
        bar = f"{ratios[against]:.2g} of {against}'s: {verdict(ratios[against], most)}" if most else ""
        shown = ["" if np.isnan(error) else f"{error:.4g}" for error in errors]
        record.add(method, f"{plain:.4g}", *shown, f"{samples:.0f}", f"{ratios[theirs]:.3g}", bar)
    record.notes += [
        f"reference: {by}, {2 * _HALF * seconds:g} s in two halves, whose difference ({own:.2g}) is subtracted",
        f"median of {seeds} seed{'s' if seeds > 1 else ''}; one after the other in one process; the time begins when "
        f"the scene is loaded, compilation included; {theirs} is Mitsuba's, in parts of half a second or more",
    ]
    return record


def _seen_through_glass(source: Any, size: tuple[int, int]) -> np.ndarray:
    """(height, width): whether the ray through the middle of a pixel meets glass first, boundaries of fog aside."""
    problem = scene.load(source, size=size)
    x, y = np.meshgrid(*((np.arange(n, dtype=np.float32) + 0.5) / n for n in size))
    film = mi.Point2f(x.ravel(), y.ravel())
    ray = problem.sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))[0]
    si = problem.scene.ray_intersect(ray)
    passes = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Null)
    behind = problem.scene.ray_intersect(si.spawn_ray(ray.d), passes)
    found = dr.select(passes, behind.bsdf().flags(), si.bsdf().flags())
    return np.array(mi.has_flag(found, mi.BSDFFlags.DeltaTransmission)).reshape(size[::-1])


def _error_in(part: np.ndarray, image: np.ndarray, reference: np.ndarray, half: np.ndarray) -> float:
    """Error in a part of the picture, as that without the worst pixels; NaN if there is no such part."""
    if not part.any():
        return float("nan")
    error, own = (relative_mse(picture[part][None], reference[part][None], trim=_TRIM) for picture in (image, half))
    return float(max(error - own, 0.0))


def _over(costs: list[float], others: list[float]) -> list[float]:
    return [cost / max(other, 1e-12) for cost, other in zip(costs, others, strict=True)]


def _taken(
    source: Any, method: str, size: tuple[int, int], seconds: float, seed: int
) -> tuple[np.ndarray, float, float]:
    """(picture, samples a pixel, seconds) of a run."""
    if method not in METHODS:
        problem = scene.load(source, size=size)
        return picture(problem, seed, seconds=seconds, part_seconds=0.5, integrator=method)
    made = render(source, method, seconds=seconds, size=size, seed=seed)
    return made.image, float(made.metadata["samples"]), float(made.metadata["seconds"])


def _box(sigma: float, **parts: Any) -> dict[str, Any]:
    """A grey box of half-width 1 full of fog; the camera looks in through its front, which only bounds the fog."""
    grey = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.6, 0.6]}}}
    place = mi.ScalarTransform4f
    sides = {
        "floor": place().translate([0, -1, 0]).rotate([1, 0, 0], -90),
        "ceiling": place().translate([0, 1, 0]).rotate([1, 0, 0], 90),
        "left": place().translate([-1, 0, 0]).rotate([0, 1, 0], 90),
        "right": place().translate([1, 0, 0]).rotate([0, 1, 0], -90),
        "back": place().translate([0, 0, -1]),
    }
    walls = {name: {"type": "rectangle", "to_world": where, "bsdf": grey} for name, where in sides.items()}
    front = {"type": "rectangle", "to_world": place().translate([0, 0, 1]), "bsdf": {"type": "null"}, "interior": _FOG}
    view = place().look_at([0, 0, 6.8], [0, 0, 0], [0, 1, 0])
    sensor = {
        "type": "perspective",
        "fov": 19.5,
        "to_world": view,
        "film": {"type": "hdrfilm", "rfilter": {"type": "box"}},
    }
    medium = {"type": "homogeneous", "sigma_t": sigma, "albedo": 0.95}
    return {"type": "scene", "fog": medium, "sensor": sensor, "front": front, **walls, **parts}


def _lamp(side: float, height: float, radiance: float, up: bool = False) -> dict[str, Any]:
    facing = mi.ScalarTransform4f().translate([0, height, 0]).rotate([1, 0, 0], -90 if up else 90).scale(side / 2)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [radiance] * 3}}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
    return {"type": "rectangle", "to_world": facing, "bsdf": black, "emitter": emitter, "exterior": _FOG}


def _shade() -> dict[str, Any]:
    """A lamp that shines up at the ceiling, out of a cylinder."""
    white = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.8, 0.8]}}}
    shade = {"type": "cylinder", "p0": [0, 0.3, 0], "p1": [0, 0.7, 0], "radius": 0.2, "bsdf": white}
    return _box(0.5, lamp=_lamp(0.2, 0.35, 60.0, up=True), shade=shade)


def _caustic() -> dict[str, Any]:
    """A glass ball below a small lamp."""
    ball = {
        "type": "sphere",
        "center": [-0.2, 0.2, 0.1],
        "radius": 0.3,
        "bsdf": {"type": "dielectric"},
        "exterior": _FOG,
    }
    return _box(1.0, lamp=_lamp(0.01, 0.98, 3e5), ball=ball)


#: Scenes of this benchmark; other names are bundled scenes.
SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "room": lambda: _box(0.7, lamp=_lamp(0.5, 0.98, 10.0)),
    "shade": _shade,
    "caustic": _caustic,
}
