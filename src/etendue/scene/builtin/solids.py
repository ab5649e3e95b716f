"""Solids as triangles, and models of them by material.

Lengths are metres, y is up. A part is points (n, 3), faces (m, 3), which look out of the solid, and vertex normals
(n, 3). The outline of a turned solid is text: "radius,height radius,height ..." in centimetres.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..meshes import MeshDescription, grid, lathe, smooth
from .pieces import Array, Dict, Range, Vector

Part = tuple[Array, NDArray[np.int64], Array]

#: Gap between solids that stand on one another, so that no two faces coincide.
GAP = 0.0005
ORIGIN: Vector = (0.0, 0.0, 0.0)


class Model:
    """Triangles by material: one mesh each, however many solids it is made of."""

    def __init__(self, materials: Mapping[str, Dict]) -> None:
        self.materials = dict(materials)
        self._parts: dict[str, list[Part]] = {}

    def add(self, material: str, part: Part, at: ArrayLike = ORIGIN, turn: Array | None = None) -> None:
        """Add a part, turned by a rotation matrix and then moved."""
        points, faces, normals = part
        if turn is not None:
            points, normals = points @ turn.T, normals @ turn.T
        self._parts.setdefault(material, []).append((points + np.asarray(at), faces, normals))

    def put(self, other: Model, at: ArrayLike = ORIGIN, turn: Array | None = None) -> None:
        """Add all of another model."""
        self.materials |= other.materials
        for material, parts in other._parts.items():
            for part in parts:
                self.add(material, part, at, turn)

    def shapes(self) -> Dict:
        """A mesh for each material that was used, by its name."""
        return {
            name: MeshDescription(name, *(found := joined(parts))[:2], self.materials[name], found[2])
            for name, parts in self._parts.items()
        }


def joined(parts: list[Part]) -> Part:
    """Several parts as one."""
    first = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    points, normals = (np.concatenate([part[i] for part in parts]) for i in (0, 2))
    return points, np.concatenate([part[1] + offset for part, offset in zip(parts, first, strict=False)]), normals


def box(size: Vector, bevel: float = 0.0, arc: int = 3, cells: int = 1) -> Part:
    """A box around the origin; with ``bevel`` its edges are round, in ``arc`` steps. Its flat parts have ``cells`` by
    ``cells`` cells, so that it can be bent."""
    half = np.array(size) / 2
    angles = np.linspace(0.0, np.pi / 4, arc + 1)[1:] if bevel > 0.0 else np.zeros(0)
    corner = bevel * np.tan(angles)
    lines = []
    for h in half - bevel:
        flat = np.linspace(-h, h, cells + 1)
        lines.append(np.concatenate([-h - corner[::-1], flat, h + corner]))
    points, faces = [], []
    count = 0
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1.0, 1.0):
            a, b = np.meshgrid(lines[u], lines[v], indexing="ij")
            sheet = np.empty((*a.shape, 3))
            sheet[..., axis], sheet[..., u], sheet[..., v] = side * half[axis], a, b
            points.append(sheet.reshape(-1, 3))
            faces.append(grid(*a.shape)[:, :: int(side)] + count)
            count += a.size
    on_cube = np.concatenate(points)
    inner = np.clip(on_cube, -(half - bevel), half - bevel)
    if bevel == 0.0:
        normals = np.repeat(np.concatenate([-np.eye(3), np.eye(3)])[[0, 3, 1, 4, 2, 5]], count // 6, axis=0)
        return on_cube, np.concatenate(faces), normals
    normals = on_cube - inner
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return inner + bevel * normals, np.concatenate(faces), normals


def cushion(size: Vector, bevel: float, swell: float, cells: int = 12) -> Part:
    """A stuffed box: its broad sides swell towards their middle."""
    points, faces, _ = box(size, bevel, 5, cells)
    half = np.array(size) / 2
    x, z = np.clip(points[:, 0] / half[0], -1, 1), np.clip(points[:, 2] / half[2], -1, 1)
    points[:, 1] += swell * np.sign(points[:, 1]) * (1 - x**2) * (1 - z**2) * (np.abs(points[:, 1]) > 0.3 * half[1])
    return points, faces, smooth_normals(points, faces)


def smooth_normals(points: Array, faces: NDArray[np.int64]) -> Array:
    """Mean normals of the faces around each point, by area; points at one place share theirs."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    _, same = np.unique(np.round(points, 6), axis=0, return_inverse=True)
    total = np.zeros((same.max() + 1, 3))
    for i in range(3):
        np.add.at(total, same.ravel()[faces[:, i]], face)
    normals = total[same.ravel()]
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def ball(radius: float, segments: int = 96, rings: int = 48) -> Part:
    """A sphere around the origin, with exact normals."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = np.stack([np.cos(angle), np.sin(angle)], -1)
    profile[[0, -1], 0] = 0.0
    points, faces, _ = lathe(profile, segments, closed=False)
    return radius * points, faces, points


def outline(text: str) -> list[Range]:
    """The (radius, height) points of a text, in metres."""
    return [(float(r) / 100, float(h) / 100) for r, h in (pair.split(",") for pair in text.split())]


def turned(corners: str | list[Range], segments: int = 48, per_corner: int = 6) -> Part:
    """A turned solid: an outline from the axis below, outside up, and back to the axis, smoothed."""
    corners = outline(corners) if isinstance(corners, str) else corners
    return lathe(smooth(np.array(corners, float), per_corner, closed=False), segments, closed=False)


def ring(corners: str | list[Range], segments: int = 64, per_corner: int = 4) -> Part:
    """A turned solid around a hole: a closed outline, smoothed."""
    corners = outline(corners) if isinstance(corners, str) else corners
    return lathe(smooth(np.array(corners, float), per_corner, closed=True), segments, closed=True)


def stretched(part: Part, *scale: float) -> Part:
    """A part with another size along each axis."""
    normals = part[2] / scale
    return part[0] * scale, part[1], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def inside_out(part: Part) -> Part:
    """The same surface as the wall of a hole."""
    points, faces, normals = part
    return points, faces[:, ::-1], -normals


def tube(curve: ArrayLike, radius: float, sides: int = 20) -> Part:
    """A pipe along a curve (n, 3), with flat ends; ``radius`` is that of its outside."""
    curve = np.asarray(curve, float)
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.empty_like(curve)
    guide = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for i, t in enumerate(tangent):  # carried along, so that the pipe does not twist
        guide = guide - t * (guide @ t)
        guide /= np.linalg.norm(guide)
        across[i] = guide
    up = np.cross(tangent, across)
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    normals = np.cos(angle)[None, :, None] * across[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    points = curve[:, None] + radius * normals
    parts: list[Part] = [(points.reshape(-1, 3), grid(len(curve), sides + 1)[:, ::-1], normals.reshape(-1, 3))]
    for end, sign in ((0, -1), (-1, 1)):
        rim = np.concatenate([curve[end][None], points[end]])
        fan = np.stack([np.zeros(sides, int), np.arange(1, sides + 1), np.arange(2, sides + 2)], -1)
        parts.append((rim, fan[:, ::sign], np.broadcast_to(sign * tangent[end], rim.shape)))
    return joined(parts)


def about(axis: int, degrees: float) -> Array:
    """Rotation about the x (0), y (1) or z axis (2)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.eye(3)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    turn[u, u], turn[u, v], turn[v, u], turn[v, v] = c, -s, s, c
    return turn
