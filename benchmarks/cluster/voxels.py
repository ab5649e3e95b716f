"""Directions by way of the occupied voxels of a scene [Leeson 2001, sec. 5.6.4, eq. 5.25], beside directions in strata:
a point on a face of the voxel is drawn, and the ray counts if its first hit is in that voxel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import mitsuba as mi
import numpy as np
import typer
from numpy.typing import NDArray

from etendue.core import Array
from etendue.particles import BoxGrid
from etendue.scene import load, shape_boxes, unmerged

from ..measuring import Record
from ..options import Seeds
from .coherence import distinct_in_windows

#: Flat surfaces, and curved ones.
_SCENES = ("cornell-box", "curved")
_WINDOW = 256
#: Lines that find the occupied voxels, and the distance of points from their surfaces, in diagonals of the scene.
_LINES, _OFF = 1 << 20, 1e-4
#: In place of a voxel: any of them; one beside the point.
_ANY, _NEAR = -1, -2


def measure(
    points: Annotated[int, typer.Option(min=16, help="Points on surfaces.")] = 256,
    rays: Annotated[int, typer.Option(min=1, help="Rays of a point in a voxel or stratum.")] = 16,
    cells: Annotated[int, typer.Option(min=2, help="Voxels along each axis.")] = 6,
    seeds: Seeds = 6,
) -> Iterator[Record]:
    """A table of each scene (figures 5.43 to 5.46)."""
    for name in _SCENES:
        yield _scene(name, points, rays, cells, seeds)


def _scene(name: str, points: int, rays: int, cells: int, seeds: int) -> Record:
    scene = load(name, change=unmerged)
    place = Place(scene.scene, BoxGrid.even(shape_boxes(scene)[1], (cells, cells, cells)), points)
    record = Record(
        f"Directions by {len(place.voxels)} voxels, {name}, {points} points, {rays} rays in each, {seeds} seeds",
        ("", "irradiance", "z", "variance / random", f"different voxels in {_WINDOW}", "different / random"),
    )
    kinds = {
        "random": place.random,
        "in strata": place.in_strata,
        "by voxels": place.by_voxels,
        "by far voxels": place.by_far_voxels,
    }
    values: dict[str, Array] = {}
    different: dict[str, float] = {}
    for kind, way in kinds.items():
        found = [place.irradiance(way(rays, np.random.default_rng(seed))) for seed in range(seeds)]
        values[kind] = np.array([value for value, _ in found])
        different[kind] = float(np.mean([distinct_in_windows(voxels, _WINDOW).mean() for _, voxels in found]))
    means = {kind: value.mean(axis=1) for kind, value in values.items()}
    noise = {kind: value.var(axis=0, ddof=1).mean() for kind, value in values.items()}
    for kind, value in means.items():
        error = np.hypot(value.std(ddof=1), means["random"].std(ddof=1)) / seeds**0.5
        z = "" if kind == "random" else f"{(value.mean() - means['random'].mean()) / error:+.1f}"
        record.add(
            *(kind, f"{value.mean():.4f}", z, f"{noise[kind] / noise['random']:.2f}"),
            *(f"{different[kind]:.1f}", f"{different[kind] / different['random']:.2f}"),
        )
    record.notes += [
        "irradiance: mean over the points, if the radiosity of a surface is its height in the scene, from 0 to 1; z: "
        "difference from random over its standard error; variance: of one point, by as many rays",
        "random: point by point; in strata: equal parts of the square of which directions of cosine density are made, "
        "part by part the rays of all points; by voxels: voxel by voxel those of all points; by far voxels: without "
        "those beside the voxel of the point, which directions of cosine density share",
        "different voxels: of first hits, in the order of casting",
    ]
    return record


@dataclass(frozen=True)
class Rays:
    """In the order of casting: (n,) points, (n, 3) directions, (n,) factors on the radiosity of the first hit, and the
    voxels in which it must be, or ``_ANY`` or ``_NEAR``."""

    point: NDArray[np.int64]
    way: Array
    factor: Array
    voxel: NDArray[np.int64]


class Place:
    """Points on surfaces of a scene, cut into voxels, and three ways to send rays from them."""

    def __init__(self, scene: mi.Scene, grid: BoxGrid, points: int) -> None:
        self._scene, self._grid = scene, grid
        box = scene.bbox()
        self._low, self._high = (np.array(corner, np.float64).ravel() for corner in (box.min, box.max))
        random = np.random.default_rng(1)
        origin = self._low + (self._high - self._low) * random.uniform(0.4, 0.6, (4 * points, 3))
        way = _anywhere(random, len(origin))
        hit, normal, valid = self._cast(origin, way)
        first = np.flatnonzero(valid)[:points]
        self._normal = np.where((normal * way).sum(axis=1, keepdims=True) < 0, normal, -normal)[first]
        self._origin = hit[first] + _OFF * np.linalg.norm(self._high - self._low) * self._normal

    def _cast(self, origin: Array, way: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """(n, 3) first hits and their normals, and whether there are any."""
        ray = mi.Ray3f(mi.Point3f(*origin.T.astype(np.float32)), mi.Vector3f(*way.T.astype(np.float32)))
        si = self._scene.ray_intersect(ray)
        return np.array(si.p, np.float64).T, np.array(si.n, np.float64).T, np.array(si.is_valid())

    @cached_property
    def voxels(self) -> NDArray[np.int64]:
        """The voxels in which many random lines from the points end."""
        random = np.random.default_rng(2)
        origin = self._origin[random.integers(len(self._origin), size=_LINES)]
        hit, _, valid = self._cast(origin, _anywhere(random, _LINES))
        return np.unique(self._grid.of_points(hit[valid]))

    def irradiance(self, rays: Rays) -> tuple[Array, NDArray[np.int64]]:
        """(points,) irradiances, and the voxels of the hits in the order of casting."""
        hit, _, valid = self._cast(self._origin[rays.point], rays.way)
        voxel = self._grid.of_points(hit)
        height = (hit[:, 1] - self._low[1]) / (self._high[1] - self._low[1])
        near = self._is_near(rays.point, voxel) & (rays.voxel == _NEAR)
        counts = valid & ((rays.voxel == _ANY) | (voxel == rays.voxel) | near)
        brought = np.where(counts, rays.factor * height, 0.0)
        return np.bincount(rays.point, brought, len(self._origin)), voxel[valid]

    def random(self, each: int, random: np.random.Generator) -> Rays:
        """Point by point, by the cosine law."""
        point = np.repeat(np.arange(len(self._origin)), each * len(self.voxels))
        return self._by_cosine(point, random.random((2, len(point))), each * len(self.voxels))

    def in_strata(self, each: int, random: np.random.Generator) -> Rays:
        """The same in about as many strata as there are voxels, stratum by stratum."""
        rows = round(len(self.voxels) ** 0.5)
        columns = len(self.voxels) // rows
        stratum, point = self._in_turn(rows * columns, each)
        u = random.random((2, len(point)))
        u = np.stack([(stratum // columns + u[0]) / rows, (stratum % columns + u[1]) / columns])
        return self._by_cosine(point, u, each * rows * columns)

    def _by_cosine(self, point: NDArray[np.int64], u: Array, rays: int) -> Rays:
        r, phi = np.sqrt(u[0]), 2.0 * np.pi * u[1]
        n = self._normal[point]
        s = np.cross(n, np.where(np.abs(n[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
        s /= np.linalg.norm(s, axis=1, keepdims=True)
        x, y, z = (v[:, None] for v in (r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - u[0])))
        way = x * s + y * np.cross(n, s) + z * n
        return Rays(point, way, np.full(len(point), 1.0 / rays), np.full(len(point), _ANY))

    def by_voxels(self, each: int, random: np.random.Generator) -> Rays:
        """Voxel by voxel: uniform points on the faces that are turned to the point, on all faces from inside."""
        which, point = self._in_turn(len(self.voxels), each)
        corners = np.array([np.clip(self._grid.bounds(v), self._low, self._high) for v in self.voxels], np.float64)
        low, high, origin = corners[which, 0], corners[which, 1], self._origin[point]
        side = high - low
        face_areas = np.roll(side, 1, axis=1) * np.roll(side, 2, axis=1)  # (n, 3) by axis
        turned = np.stack([origin < low, origin > high], axis=2)  # (n, 3, 2): lower and upper face of each axis
        turned |= ~turned.any(axis=(1, 2))[:, None, None]
        areas = (turned * face_areas[:, :, None]).reshape(-1, 6)
        sums = areas.cumsum(axis=1)
        face = (random.random(len(point))[:, None] * sums[:, -1:] >= sums).sum(axis=1).clip(max=5)
        lane, axis = np.arange(len(point)), face // 2
        target = low + random.random((len(point), 3)) * side
        target[lane, axis] = np.where(face % 2, high[lane, axis], low[lane, axis])
        way = target - origin
        square = (way**2).sum(axis=1)
        way /= np.sqrt(square)[:, None]
        cosine = np.maximum((way * self._normal[point]).sum(axis=1), 0.0)
        density = square / np.maximum(sums[:, -1] * np.abs(way[lane, axis]), 1e-30)
        return Rays(point, way, cosine / (np.pi * density * each), self.voxels[which])

    def by_far_voxels(self, each: int, random: np.random.Generator) -> Rays:
        """The same for voxels that are not beside that of the point, as close to a face the factor is unbounded; as
        many rays as into the others by the cosine law, which count if they hit one of those."""
        far, near = self.by_voxels(each, random), self.random(each, random)
        kept = ~self._is_near(far.point, far.voxel)
        others = len(self.voxels) * each - np.bincount(far.point[kept], minlength=len(self._origin))
        number = np.arange(len(near.point)) % (len(self.voxels) * each)
        first = number < others[near.point]
        return Rays(
            np.concatenate([near.point[first], far.point[kept]]),
            np.concatenate([near.way[first], far.way[kept]]),
            np.concatenate([1.0 / others[near.point[first]], far.factor[kept]]),
            np.concatenate([np.full(first.sum(), _NEAR), far.voxel[kept]]),
        )

    def _is_near(self, point: NDArray[np.int64], voxel: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether voxels are those of points, or beside them."""
        digits = np.array([self._grid.codes.digits(code) for code in range(len(self._grid))])
        own = digits[self._grid.of_points(self._origin)][point]
        found: NDArray[np.bool_] = (np.abs(digits[voxel] - own) <= 1).all(axis=1)
        return found

    def _in_turn(self, parts: int, each: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(n,) parts and points of rays: part by part, in each the rays of all points."""
        part = np.repeat(np.arange(parts), each * len(self._origin))
        return part, np.tile(np.repeat(np.arange(len(self._origin)), each), parts)


def _anywhere(random: np.random.Generator, count: int) -> Array:
    """(count, 3) uniform directions."""
    way: Array = random.normal(size=(count, 3))
    return way / np.linalg.norm(way, axis=1, keepdims=True)
