"""Lightmaps: values on surfaces as a texture for the texture coordinates of a mesh."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, Result
from etendue.film import write_exr
from etendue.scene import RenderSpace

from ..errors import SurfaceError
from ..places import PatchSurfaces, SurfaceValues
from .atlases import TexturedMesh, mesh_normals

Index = NDArray[np.int64]

#: A texel is inside a triangle if its centre is at least this part of the triangle's height away from the edges; texels
#: closer to an edge may lie in two triangles.
_INSIDE = 1e-3
#: Texels that are processed at once.
_BLOCK = 1 << 21


@dataclass
class Lightmap:
    """A texture. ``values``: (height, width, 3), float32, the first row being that of v = 1. ``covered``: (height,
    width), whether a triangle covers the texel; others have the value of the nearest covered texel, so that filters do
    not bleed black."""

    values: NDArray[np.float32]
    covered: NDArray[np.bool_]


def lightmap_of(surfaces: PatchSurfaces, values: SurfaceValues, mesh: TexturedMesh, size: tuple[int, int]) -> Lightmap:
    """:func:`lightmap_from` for ``values`` on patches. Also raises :class:`SurfaceError` if no patch lies on the
    mesh."""
    return lightmap_from(functools.partial(_evaluate, surfaces, values), mesh, size)


def lightmap_from(
    evaluate: Callable[[Array, Array], tuple[NDArray[np.float32], NDArray[np.bool_]]],
    mesh: TexturedMesh,
    size: tuple[int, int],
) -> Lightmap:
    """A texture of (width, height) ``size`` with a function on the surfaces of the mesh.

    evaluate: (colours (k, 3), whether there is a colour (k,)) at points (k, 3) with normals (k, 3).

    Every texel whose centre lies in a triangle gets the value at that point; a triangle that contains no texel centre
    gives the texel at the centre of the triangle its value. All other texels get the value of the nearest of these.

    Raises :class:`SurfaceError` if triangles overlap in the texture or leave the unit square, and if there is no colour
    anywhere.
    """
    width, height = size
    if min(size) < 1:
        raise SurfaceError(f"a lightmap has at least one texel, not {width} x {height}")
    texel, points, normals = _texels(mesh, width, height)
    colours, found = evaluate(points, normals)
    if not found.any():
        raise SurfaceError("the mesh with the texture coordinates is not on the patches; give the mesh of the patches")
    row, column = np.divmod(texel[found], width)
    image = np.zeros((height, width, 3), np.float32)
    covered = np.zeros((height, width), dtype=bool)
    image[row, column], covered[row, column] = colours[found], True
    return Lightmap(_filled(image, covered), covered)


def check_coordinates(mesh: TexturedMesh, size: tuple[int, int]) -> None:
    """Raises :class:`SurfaceError` if a mesh is not suitable for a lightmap of this (width, height): if triangles
    overlap in the texture or leave the unit square."""
    _texels(mesh, *size)


def save_lightmap(path: str | os.PathLike[str], made: Lightmap, metadata: dict[str, Any] | None = None) -> None:
    """Write ``.exr``: the texture as R, G, B, floats, and nothing else, since texture readers do not support layers."""
    if Path(path).suffix.lower() != ".exr":
        raise SurfaceError(f"a lightmap is written as .exr, not as '{path}'; change the name")
    write_exr(path, Result({"image": made.values}, {"method": "lightmap"} | (metadata or {})))


def _texels(mesh: TexturedMesh, width: int, height: int) -> tuple[Index, Array, Array]:
    """Texels (k,) that triangles cover, the points (k, 3) at their centres, and the normals there."""
    if not np.isfinite(mesh.uv).all() or mesh.uv.min() < -1e-6 or mesh.uv.max() > 1 + 1e-6:
        raise SurfaceError(
            "texture coordinates leave the unit square, so that parts of the surface would share texels; unwrap the "
            "mesh for lightmaps, or let an atlas be made"
        )
    corners = np.column_stack([mesh.uv[:, 0] * width, (1 - mesh.uv[:, 1]) * height])[mesh.faces]
    owner = np.full(width * height, -1, dtype=np.int64)
    weights = np.zeros((width * height, 3), np.float32)
    for triangle, x, y in _candidates(corners, width, height):
        own = corners[triangle]
        inside = _barycentric(own, np.stack([x + 0.5, y + 0.5], axis=1))
        least = inside.min(axis=1)
        texel = y * width + x
        deep = least > _INSIDE
        _refuse_overlap(owner, texel[deep], triangle[deep], width)
        taken = deep | ((least >= 0) & (owner[texel] < 0))
        owner[texel[taken]], weights[texel[taken]] = triangle[taken], inside[taken]
    without = np.setdiff1d(np.arange(len(mesh.faces)), owner)
    middle = corners[without].mean(axis=1).astype(np.int64)
    texel = np.clip(middle[:, 1], 0, height - 1) * width + np.clip(middle[:, 0], 0, width - 1)
    free = owner[texel] < 0
    owner[texel[free]], weights[texel[free]] = without[free], 1 / 3
    covered = np.flatnonzero(owner >= 0)
    a, b, c = (mesh.vertices[mesh.faces[owner[covered], k]] for k in range(3))
    # Relative to a corner: single-precision weights do not add up to 1, which matters far from the origin.
    points = a + weights[covered, 1:2] * (b - a) + weights[covered, 2:] * (c - a)
    return covered, points, mesh_normals(mesh)[owner[covered]]


def _candidates(corners: Array, width: int, height: int) -> Iterator[tuple[Index, Index, Index]]:
    """Triangles and the texels (x, y) with centres in their bounding boxes, a few million at a time."""
    low = np.maximum(np.ceil(corners.min(axis=1) - 0.5).astype(np.int64), 0)
    high = np.minimum(np.floor(corners.max(axis=1) - 0.5).astype(np.int64), [width - 1, height - 1])
    extent = np.maximum(high - low + 1, 0)
    # Rows first: a row of a box is a run of texels.
    rows = np.repeat(np.arange(len(corners)), extent[:, 1])
    y = low[rows, 1] + _running(extent[:, 1])
    ends = np.cumsum(extent[rows, 0])
    start = 0
    while start < len(rows):
        done = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, done + _BLOCK, side="right")), start + 1)
        part = rows[start:stop]
        triangle = np.repeat(part, extent[part, 0])
        x = low[triangle, 0] + _running(extent[part, 0])
        yield triangle, x, np.repeat(y[start:stop], extent[part, 0])
        start = stop


def _running(counts: Index) -> Index:
    """0, 1, ... for each count, one after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)


def _barycentric(corners: Array, p: Array) -> Array:
    """Weights (k, 3) of the corners (k, 3, 2) at points (k, 2); negative for triangles without area."""
    a, b, c = (corners[:, k] for k in range(3))
    area = _cross(b - a, c - a)
    parts = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1)
    return np.divide(parts, area[:, None], out=np.full_like(parts, -1.0), where=area[:, None] != 0)


def _cross(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _refuse_overlap(owner: Index, texel: Index, triangle: Index, width: int) -> None:
    """Raises :class:`SurfaceError` if a texel is inside two of these triangles."""
    order = np.argsort(texel, kind="stable")
    texel, triangle = texel[order], triangle[order]
    again = np.flatnonzero(texel[1:] == texel[:-1])
    if len(again):
        first, one, other = texel[again[0]], triangle[again[0]], triangle[again[0] + 1]
    elif len(again := np.flatnonzero(owner[texel] >= 0)):
        first, one, other = texel[again[0]], owner[texel[again[0]]], triangle[again[0]]
    else:
        return
    raise SurfaceError(
        f"texture coordinates overlap: triangles {one} and {other} share texel ({first % width}, {first // width}) of "
        "the lightmap; unwrap the mesh for lightmaps, or let an atlas be made"
    )


def _evaluate(
    surfaces: PatchSurfaces, values: SurfaceValues, points: Array, normals: Array
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Colours (k, 3) at points, and whether there is a patch."""
    import mitsuba as mi

    x, y, z = surfaces.patches.sphere[0]
    space = RenderSpace((x, y, z))  # far from the origin single precision would not hold the points
    p, n = (np.ascontiguousarray(rows.T, dtype=np.float32) for rows in (space.from_scene(points), normals))
    place = surfaces.find(mi.Point3f(p), mi.Normal3f(n), True, space)
    return np.array(values.at(place)).T, np.array(place.found)


def _filled(image: NDArray[np.float32], covered: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The image with every uncovered texel replaced by the nearest covered one."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return image[rows, columns]
