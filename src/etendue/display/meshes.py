"""The face of a mesh that each pixel shows: a projection and a depth buffer in NumPy, for pages without a renderer.

Only fronts are drawn, so that a room is seen from outside through the backs of its nearer walls.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Fragments that are tested at once, which bounds memory.
_CHUNK = 4_000_000
#: Vertices nearer than this share of the farthest distance are cut off.
_NEAR = 1e-4


@dataclass(frozen=True)
class MeshView:
    """A view of a mesh.

    A point p is seen at (x, y) / z with (x, y, z) = ``matrix`` (p - ``eye``): x and y are in [0, 1] from the upper left
    corner of the picture, z is the depth.
    """

    name: str
    matrix: Array
    eye: Array

    @classmethod
    def from_corners(cls, name: str, eye: ArrayLike, corners: ArrayLike) -> MeshView:
        """The view of a camera from the directions of its upper left, upper right and lower left corners, (3, 3), whose
        ends lie in one plane parallel to the picture."""
        origin, across, down = np.asarray(corners, dtype=np.float64)
        return cls(name, np.linalg.inv(np.stack([across - origin, down - origin, origin], axis=1)), np.asarray(eye))

    @classmethod
    def around(cls, name: str, vertices: ArrayLike, direction: ArrayLike, up: ArrayLike, aspect: float) -> MeshView:
        """A view along ``direction`` from outside that shows all ``vertices``; ``aspect``: width over height."""
        points = np.asarray(vertices, dtype=np.float64)
        low, high = points.min(axis=0), points.max(axis=0)
        centre, radius = (low + high) / 2.0, max(float(np.linalg.norm(high - low)) / 2.0, 1e-12)
        z = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
        x = np.cross(z, np.asarray(up, dtype=np.float64))
        x /= np.linalg.norm(x)
        y = np.cross(z, x)  # down
        eye = centre - 3.2 * radius * z
        seen = (points - eye) @ np.stack([x, y, z], axis=1)
        across, down = np.ptp(seen[:, :2] / seen[:, 2:], axis=0)
        middle = (seen[:, :2] / seen[:, 2:]).min(axis=0) + np.array([across, down]) / 2.0
        height = 1.06 * max(down, across / aspect, 1e-9)
        width = aspect * height
        corner = z + (middle[0] - width / 2.0) * x + (middle[1] - height / 2.0) * y
        return cls.from_corners(name, eye, [corner, corner + width * x, corner + height * y])


def mesh_picture(
    vertices: ArrayLike, faces: ArrayLike, view: MeshView, size: tuple[int, int], two_sided: ArrayLike = False
) -> NDArray[np.int64]:
    """(height, width) numbers of the faces at the middle of the pixels, plus f for the back of a two-sided face; -1 for
    no face.

    ``faces``: (f, 4) indices of vertices, of convex quadrilaterals or of triangles that repeat their last vertex.
    ``size``: width and height. ``two_sided``: one value for all faces, or one for each.
    """
    width, height = size
    corners = np.asarray(faces, dtype=np.int64)
    count = len(corners)
    both = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    number = np.concatenate([np.arange(count), np.arange(count)])
    proper = (both[:, 0] != both[:, 1]) & (both[:, 1] != both[:, 2]) & (both[:, 2] != both[:, 0])
    both, number = both[proper], number[proper]
    camera = (np.asarray(vertices, dtype=np.float64) - view.eye) @ view.matrix.T
    triangles = camera[both]  # (t, 3, 3)
    # The determinant of the corners as seen from the eye; y points down, so that a front is positive.
    flips = np.sign(np.linalg.det(view.matrix)) or 1.0
    facing = -flips * np.linalg.det(triangles)
    drawn = (facing > 0) | ((facing < 0) & np.broadcast_to(two_sided, count)[number])
    number = np.where(facing < 0, number + count, number)[drawn]
    triangles, number = _clipped(triangles[drawn], number, _NEAR * max(float(camera[:, 2].max(initial=0.0)), 1e-300))
    depths, shown = np.full(width * height, np.inf), np.full(width * height, -1, dtype=np.int64)
    for pixel, depth, owner in _fragments(triangles, number, width, height):
        # An assignment keeps the last of equal indices, so the nearest fragment comes last.
        order = np.argsort(-depth, kind="stable")
        pixel, depth, owner = pixel[order], depth[order], owner[order]
        nearer = depth < depths[pixel]
        depths[pixel[nearer]], shown[pixel[nearer]] = depth[nearer], owner[nearer]
    return shown.reshape(height, width)


def _clipped(triangles: Array, number: NDArray[np.int64], near: float) -> tuple[Array, NDArray[np.int64]]:
    """The parts of triangles with depths of at least ``near``."""
    inside = triangles[:, :, 2] >= near
    count = inside.sum(axis=1)
    parts, owners = [triangles[count == 3]], [number[count == 3]]
    for corners in (1, 2):
        rows = np.flatnonzero(count == corners)
        if not len(rows):
            continue
        # Turned so that the corner that differs from the other two is the first.
        first = np.argmax(inside[rows] == (corners == 1), axis=1)
        a, b, c = (triangles[rows, (first + k) % 3] for k in range(3))
        ab, ac = _cut(a, b, near), _cut(a, c, near)
        made = [(a, ab, ac)] if corners == 1 else [(ab, b, c), (ab, c, ac)]
        parts += [np.stack(part, axis=1) for part in made]
        owners += [number[rows]] * len(made)
    return np.concatenate(parts), np.concatenate(owners)


def _cut(a: Array, b: Array, near: float) -> Array:
    """The points where edges cross the near plane."""
    share = (near - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    return a + share * (b - a)


def _fragments(
    triangles: Array, number: NDArray[np.int64], width: int, height: int
) -> Iterator[tuple[NDArray[np.int64], Array, NDArray[np.int64]]]:
    """Pixels, depths and numbers of triangles, in chunks."""
    z = triangles[:, :, 2]
    x, y = triangles[:, :, 0] / z * width - 0.5, triangles[:, :, 1] / z * height - 0.5
    # Pixels whose middle may be inside: a box of whole numbers.
    left, right = np.ceil(x.min(axis=1)).clip(0), np.floor(x.max(axis=1)).clip(None, width - 1)
    top, bottom = np.ceil(y.min(axis=1)).clip(0), np.floor(y.max(axis=1)).clip(None, height - 1)
    columns, rows = (right - left + 1).clip(0).astype(np.int64), (bottom - top + 1).clip(0).astype(np.int64)
    counts = columns * rows
    kept = np.flatnonzero(counts)
    edges = np.searchsorted(np.cumsum(counts[kept]), np.arange(_CHUNK, counts.sum() + _CHUNK, _CHUNK))
    for part in np.split(kept, np.minimum(edges + 1, len(kept))):
        if not len(part):
            continue
        which = np.repeat(part, counts[part])
        inner = np.arange(len(which)) - np.repeat(np.cumsum(counts[part]) - counts[part], counts[part])
        px, py = left[which] + inner % columns[which], top[which] + inner // columns[which]
        # Barycentric coordinates on the screen, in which 1 / z is linear.
        x0, x1, x2 = (x[which, k] for k in range(3))
        y0, y1, y2 = (y[which, k] for k in range(3))
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        with np.errstate(divide="ignore", invalid="ignore"):
            b1 = ((px - x0) * (y2 - y0) - (x2 - x0) * (py - y0)) / area
            b2 = ((x1 - x0) * (py - y0) - (px - x0) * (y1 - y0)) / area
            b0 = 1.0 - b1 - b2
            inverse = b0 / z[which, 0] + b1 / z[which, 1] + b2 / z[which, 2]
            covered = (b0 >= -1e-9) & (b1 >= -1e-9) & (b2 >= -1e-9) & (inverse > 0.0)
        yield (py * width + px)[covered].astype(np.int64), 1.0 / inverse[covered], number[which[covered]]
