"""Shapes of a Mitsuba scene as flat faces, and the surface interactions at points of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, UnsupportedError
from etendue.scene import graph

if TYPE_CHECKING:
    import mitsuba as mi

Index = NDArray[np.int64]

#: Points of a face at which textures are read.
POINTS = 16


def tessellate(shape: mi.Shape, segments: int) -> tuple[Array, Index, mi.SurfaceInteraction3f]:
    """Vertices (v, 3), faces (m, 4), oriented as the shape, and interactions at ``POINTS`` points of each face, grouped
    by face, with a direction along the normal.

    A circle becomes a polygon of ``segments`` sides inside it. Raises :class:`UnsupportedError` for curves, volumes and
    instances.
    """
    import mitsuba as mi

    kind = shape.shape_type()
    points, faces, cells = _faces(shape, segments)
    if cells is not None:
        at = shape.eval_parameterization(mi.Point2f(*_in_cells(cells, is_disk=kind == mi.ShapeType.Disk)))
        if kind == mi.ShapeType.Rectangle:  # its parameterisation ignores flipped normals
            at.n = shape.sample_position(0.0, mi.Point2f(0.5, 0.5)).n
    else:
        at = _of_mesh(shape, len(faces))
    at.wi = mi.Vector3f(0, 0, 1)
    normals = face_means(at.n, len(faces))
    a, b, c, d = (points[faces[:, i]] for i in range(4))
    is_turned = (np.cross(c - a, d - b) * normals).sum(axis=1) < 0
    faces[is_turned] = faces[is_turned][:, [0, 3, 2, 1]]
    triangle = is_turned & (faces[:, 2] == faces[:, 1])  # the repeated corner of a triangle is now the second
    faces[triangle] = faces[triangle][:, [0, 1, 3, 3]]
    return points, faces, at


def shape_triangles(shape: mi.Shape, segments: int = 32) -> Array:
    """Triangles (n, 3, 3) of a shape, counterclockwise from the side of its normal. Raises as :func:`tessellate`."""
    points, faces, cells = _faces(shape, segments)
    if cells is None:
        corners = faces[:, [0, 2, 1]] if shape.has_flipped_normals() else faces[:, :3]
        return np.asarray(points[corners])
    points, faces, _ = tessellate(shape, segments)  # turns faces to the side of the normal
    first = np.where((faces[:, 1] == faces[:, 2])[:, None], faces[:, [0, 1, 3]], faces[:, :3])
    second = faces[(faces[:, 2] != faces[:, 3]) & (faces[:, 1] != faces[:, 2])][:, [0, 2, 3]]
    return np.asarray(points[np.concatenate([first, second])])


def _faces(shape: mi.Shape, segments: int) -> tuple[Array, Index, Array | None]:
    """(vertices, faces, parameters of the faces); ``None`` for those of a mesh."""
    import mitsuba as mi

    kind = shape.shape_type()
    grids = {
        mi.ShapeType.Rectangle: lambda: _grid(1, 1),
        mi.ShapeType.Disk: lambda: _disk(segments),
        mi.ShapeType.Sphere: lambda: _grid(segments, max(segments // 2, 2), wraps=True, poles=True),
        mi.ShapeType.Cylinder: lambda: _grid(segments, 1, wraps=True),
    }
    if kind in grids:
        uv, faces, cells = grids[kind]()
        matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        return _local(kind, uv) @ matrix[:3, :3].T + matrix[:3, 3], faces, cells
    if shape.is_mesh():
        points = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
        return points, np.array(shape.faces_buffer(), dtype=np.int64).reshape(-1, 3)[:, [0, 1, 2, 2]], None
    raise UnsupportedError(
        f"{graph.describe(shape, 'shape')} has no flat faces and is not tessellated; replace it by a mesh"
    )


def face_means(values: mi.Color3f, faces: int) -> Array:
    """Means (m, 3) over the points of each face of three numbers per point, or of constants."""
    x = np.array(values, dtype=np.float64).reshape(3, -1)
    return np.broadcast_to(x, (3, faces * POINTS)).reshape(3, faces, POINTS).mean(axis=2).T


def _local(kind: mi.ShapeType, uv: Array) -> Array:
    """Points of the unit shape from its parameters."""
    import mitsuba as mi

    u, v = uv.T
    if kind == mi.ShapeType.Rectangle:
        return np.stack([2 * u - 1, 2 * v - 1, np.zeros_like(u)], axis=1)
    if kind == mi.ShapeType.Disk:
        return np.stack([u * np.cos(2 * np.pi * v), u * np.sin(2 * np.pi * v), np.zeros_like(u)], axis=1)
    phi = 2 * np.pi * u
    if kind == mi.ShapeType.Sphere:
        sine = np.sin(np.pi * v)
        return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(np.pi * v)], axis=1)
    return np.stack([np.cos(phi), np.sin(phi), v], axis=1)


def _grid(columns: int, rows: int, wraps: bool = False, poles: bool = False) -> tuple[Array, Index, Array]:
    """Parameters (p, 2) of the corners, quadrilaterals, and the lowest and highest parameters (m, 2, 2) of each. The
    grid may close on itself in u, and shrink to a point at both ends of v, where quadrilaterals become triangles."""
    i, j = (x.ravel() for x in np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij"))
    uv = np.stack([i / columns, j / rows], axis=1)

    def number(column: Index, row: Index) -> Index:
        if wraps:
            column = column % columns
        if poles:
            column = np.where((row == 0) | (row == rows), 0, column)
        return column * (rows + 1) + row

    i, j = (x.ravel() for x in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    quads = np.stack([number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)], axis=1)
    same = quads[:, 0] == quads[:, 1]
    quads[same] = quads[same][:, [1, 2, 3, 3]]
    cells = np.stack([i / columns, j / rows, (i + 1) / columns, (j + 1) / rows], axis=1)
    return uv, quads, cells.reshape(-1, 2, 2)


def _disk(segments: int) -> tuple[Array, Index, Array]:
    """As :func:`_grid`, for a fan of triangles; the parameters are radius and angle."""
    k = np.arange(segments)
    uv = np.concatenate([[[0.0, 0.0]], np.stack([np.ones(segments), k / segments], axis=1)])
    after = (k + 1) % segments + 1
    cells = np.stack([np.zeros(segments), k / segments, np.ones(segments), (k + 1) / segments], axis=1)
    return uv, np.stack([np.zeros_like(k), k + 1, after, after], axis=1), cells.reshape(-1, 2, 2)


def _pattern() -> tuple[Array, Array]:
    """Points evenly spread over the unit square."""
    i = np.arange(POINTS) + 0.5
    return i / POINTS, np.mod(i * 0.6180339887498949, 1.0)


def _in_cells(cells: Array, is_disk: bool) -> Array:
    """Parameters (2, m POINTS) of ``POINTS`` points in each cell."""
    s, t = _pattern()
    pattern = np.stack([np.sqrt(s) if is_disk else s, t], axis=1)
    uv = cells[:, :1] + pattern * (cells[:, 1:] - cells[:, :1])
    return uv.reshape(-1, 2).T


def _of_mesh(shape: mi.Shape, count: int) -> mi.SurfaceInteraction3f:
    import mitsuba as mi

    s, t = _pattern()
    u, v = np.tile(np.sqrt(s) * (1 - t), count), np.tile(np.sqrt(s) * t, count)
    pi = dr.zeros(mi.PreliminaryIntersection3f, count * POINTS)
    pi.valid, pi.t, pi.shape = mi.Bool(True), mi.Float(1.0), mi.ShapePtr(shape)
    pi.prim_index = mi.UInt32(np.repeat(np.arange(count), POINTS))
    pi.prim_uv = mi.Point2f(u, v)
    ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0))
    return pi.compute_surface_interaction(ray, mi.RayFlags.All)
