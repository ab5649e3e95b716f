"""The kd-tree of ``etendue.density`` beside scipy's ``cKDTree``: build, k nearest neighbours, and a visit to each.

Points lie as in a photon map: on five walls of a box, on a sphere in it, and an eighth of them in a bright spot on the
floor. Queries are what the pixels of a camera before the box see.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import OptionError

from .measuring import Clock, Record, interleaved, spread, verdict
from .options import Rounds, Size, WarmUp

_SPHERE, _RADIUS = np.array([0.3, -0.65, 0.2]), 0.35
_CAMERA, _SLOPE = np.array([0.0, 0.0, 3.9]), 0.34
_BAR = 3.0


def photons(count: int, seed: int = 0) -> np.ndarray:
    """Points on the surfaces of the box [-1, 1]^3, which is open in front, in random order: (count, 3), float32."""
    random = np.random.default_rng(seed)
    points = random.uniform(-1, 1, (count, 3))
    kind = random.integers(8, size=count)
    wall = np.flatnonzero(kind < 6)
    axis, side = np.array([(0, -1), (0, 1), (1, -1), (1, 1), (2, -1)])[random.integers(5, size=len(wall))].T
    points[wall, axis] = side
    sphere = kind == 6
    direction = random.normal(size=(sphere.sum(), 3))
    points[sphere] = _SPHERE + _RADIUS * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    spot = kind == 7
    points[spot] = random.normal((0.3, -1.0, 0.2), (0.08, 0.0, 0.08), (spot.sum(), 3))
    return points.astype(np.float32)


def seen(width: int, height: int) -> np.ndarray:
    """The nearest surface of the box or the sphere in each pixel, row by row: (width height, 3), float32."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    x, y = (2 * x.ravel() - 1) * _SLOPE, (1 - 2 * y.ravel()) * _SLOPE
    direction = np.stack([x, y, np.full_like(x, -1.0)], axis=1)
    # From inside the columns of the box, the first of its planes ahead is a wall.
    with np.errstate(divide="ignore"):
        planes = np.stack([1 / np.abs(x), 1 / np.abs(y), np.full_like(x, _CAMERA[2] + 1)])
    distance = planes.min(axis=0)
    a, b = (direction**2).sum(axis=1), direction @ (_CAMERA - _SPHERE)
    c = ((_CAMERA - _SPHERE) ** 2).sum() - _RADIUS**2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    hit = b * b > a * c
    distance[hit] = np.minimum(distance, (-b - root) / a)[hit]
    points: np.ndarray = (_CAMERA + distance[:, None] * direction).astype(np.float32)
    return points


def measure(
    count: Annotated[int, typer.Option("--points", min=1, help="Points in the tree.")] = 1_000_000,
    k: Annotated[int, typer.Option("-k", min=1, help="Neighbours of a query.")] = 50,
    size: Size = "512x512",
    rounds: Rounds = 7,
    warm_up: WarmUp = 1,
) -> Record:
    """Both trees in turn, on the same points and with all cores of this process."""
    if k > count:
        raise OptionError(f"-k {k} is more than there are points ({count})")
    import drjit as dr
    import mitsuba as mi

    from etendue.density import KdTree

    try:
        from scipy.spatial import cKDTree
    except ImportError:
        raise SystemExit("knn compares with scipy, which is not installed: pip install -e .[dev]") from None

    points, queries = photons(count), seen(*size)

    def device(values: np.ndarray) -> Any:
        lanes = mi.Point3f(*(mi.Float(np.ascontiguousarray(side)) for side in values.T))
        dr.make_opaque(lanes)
        return lanes

    on_device, point = device(points), device(queries)
    flux = dr.full(mi.Float, 1.0, 3 * count)
    dr.make_opaque(flux)
    result: dict[str, Any] = {}

    def build(_: int) -> None:
        result["tree"] = KdTree(on_device)
        dr.sync_thread()

    def kth(_: int) -> None:
        result["squared"] = result["tree"].kth_distance_squared(point, k, dr.inf)
        dr.eval(result["squared"])
        dr.sync_thread()

    def visit(_: int) -> None:
        def add(place: Any, distance_squared: Any, total: Any) -> Any:
            return total + dr.gather(mi.Color3f, flux, place)

        result["sum"] = result["tree"].within(point, result["squared"], mi.Color3f(0.0), add)
        dr.eval(result["sum"])
        dr.sync_thread()

    def scipy_build(_: int) -> None:
        result["scipy tree"] = cKDTree(points)

    def scipy_query(_: int) -> None:
        result["distances"] = result["scipy tree"].query(queries, k, workers=-1)[0]

    tasks = {"build": build, "k-th": kth, "visit": visit, "scipy build": scipy_build, "scipy query": scipy_query}
    times = interleaved(tasks, rounds, warm_up)
    distance = np.sqrt(np.array(result["squared"]))
    expected = result["distances"].reshape(len(queries), k)[:, -1]
    error = np.max(np.abs(distance - expected) / expected)
    if not error < 1e-5 or np.array(result["sum"].x).min() < k:
        raise SystemExit(f"the trees disagree: k-th distances differ by {error:g}, relative")

    record = Record(
        f"k nearest neighbours, {count} points, k = {k}, {size[0]}x{size[1]} queries",
        ("", "kd-tree s", "scipy s", "ratio", "bar"),
    )
    rows = (
        ("build", ["build"], ["scipy build"]),
        ("k-th distance and visit", ["k-th", "visit"], ["scipy query"]),
        ("all", ["build", "k-th", "visit"], ["scipy build", "scipy query"]),
    )
    for name, of_ours, of_theirs in rows:
        ours, theirs = _sum(times[task] for task in of_ours), _sum(times[task] for task in of_theirs)
        ratio = [a / b for a, b in zip(ours, theirs, strict=True)]
        bar = verdict(statistics.median(ratio), _BAR if name == "all" else None)
        record.add(name, f"{statistics.median(ours):.3f}", f"{statistics.median(theirs):.3f}", spread(ratio), bar)
    record.notes += [
        f"median of {rounds} rounds in turn after {warm_up} to warm up; a ratio is that of one round (min … max)",
        f"scipy returns distances and indices; a visit gathers three numbers of each neighbour, and is "
        f"{statistics.median(clock.wall for clock in times['visit']):.3f} s of the time",
        f"k-th distances of both trees agree to {error:.1g}, relative",
    ]
    return record


def _sum(parts: Iterable[list[Clock]]) -> list[float]:
    """Wall time of each round."""
    return [sum(clock.wall for clock in clocks) for clocks in zip(*parts, strict=True)]
