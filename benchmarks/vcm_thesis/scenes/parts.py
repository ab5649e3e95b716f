"""What the rooms are built of: solids as triangles, materials, textures, and a model of triangles by material.

Lengths are metres, y is up. A part is points (n, 3), faces (m, 3), which look out of the solid, and vertex normals
(n, 3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.scene import meshes

Array = NDArray[np.float64]
Part = tuple[Array, NDArray[np.int64], Array]
Vector = tuple[float, float, float]

#: Gap between solids that stand on one another, so that no two faces coincide.
GAP = 0.0005


class Model:
    """Triangles by material: one mesh each, however many solids it is made of."""

    def __init__(self, materials: Mapping[str, dict[str, Any]]) -> None:
        self._materials = materials
        self._parts: dict[str, list[Part]] = {}

    def add(self, material: str, part: Part, at: Vector = (0.0, 0.0, 0.0), turn: Array | None = None) -> None:
        """Add a part, turned by a rotation matrix and then moved."""
        points, faces, normals = part
        if turn is not None:
            points, normals = points @ turn.T, normals @ turn.T
        self._parts.setdefault(material, []).append((points + np.array(at), faces, normals))

    def shapes(self) -> dict[str, Any]:
        """A mesh for each material that was used, by its name."""
        return {name: self._joined(name, parts) for name, parts in self._parts.items()}

    def triangles(self) -> int:
        """Of all parts together."""
        return sum(len(faces) for parts in self._parts.values() for _, faces, _ in parts)

    def _joined(self, name: str, parts: list[Part]) -> Any:
        first = np.cumsum([0, *(len(points) for points, _, _ in parts)])
        points, normals = (np.concatenate([part[i] for part in parts]) for i in (0, 2))
        faces = np.concatenate([part[1] + offset for part, offset in zip(parts, first, strict=False)])
        return meshes.MeshDescription(name, points, faces, self._materials[name], normals).build()


# ---------------------------------------------------------------------- solids


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
            quads = _grid(*a.shape)
            faces.append((quads if side > 0 else quads[:, ::-1]) + count)
            count += a.size
    on_cube = np.concatenate(points)
    inner = np.clip(on_cube, -(half - bevel), half - bevel)
    if bevel == 0.0:
        normals = np.repeat(np.concatenate([-np.eye(3), np.eye(3)])[[0, 3, 1, 4, 2, 5]], count // 6, axis=0)
        return on_cube, np.concatenate(faces), normals
    normals = on_cube - inner
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return inner + bevel * normals, np.concatenate(faces), normals


def _grid(rows: int, columns: int) -> NDArray[np.int64]:
    """Faces of a grid of points, row by row, looking along (row axis) x (column axis)."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([a, a + columns, a + columns + 1], -1)
    return np.concatenate([lower, np.stack([a, a + columns + 1, a + 1], -1)])


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
    points, faces, _ = meshes.lathe(profile, segments, closed=False)
    return radius * points, faces, points


def turned(corners: Sequence[tuple[float, float]], segments: int = 48, per_corner: int = 6) -> Part:
    """A turned solid: the (radius, height) polygon from the axis below, outside up, and back to the axis, smoothed."""
    return meshes.lathe(meshes.smooth(np.array(corners, float), per_corner, closed=False), segments, closed=False)


def ring(corners: Sequence[tuple[float, float]], segments: int = 64, per_corner: int = 4) -> Part:
    """A turned solid around a hole: a closed (radius, height) polygon, smoothed."""
    return meshes.lathe(meshes.smooth(np.array(corners, float), per_corner, closed=True), segments, closed=True)


def tube(curve: Array, radius: float, sides: int = 20) -> Part:
    """A pipe along a curve (n, 3), with flat ends; ``radius`` is that of its outside."""
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
    faces = _grid(len(curve), sides + 1)[:, ::-1]
    parts: list[Part] = [(points.reshape(-1, 3), faces, normals.reshape(-1, 3))]
    for end, sign in ((0, -1.0), (-1, 1.0)):
        rim = np.concatenate([curve[end][None], points[end]])
        fan = np.stack([np.zeros(sides, int), np.arange(1, sides + 1), np.arange(2, sides + 2)], -1)
        parts.append((rim, fan if sign > 0 else fan[:, ::-1], np.broadcast_to(sign * tangent[end], rim.shape)))
    first = np.cumsum([0, *(len(p) for p, _, _ in parts)])
    joined = [np.concatenate([part[i] for part in parts]) for i in (0, 2)]
    return joined[0], np.concatenate([f + o for (_, f, _), o in zip(parts, first, strict=False)]), joined[1]


def about_y(degrees: float) -> Array:
    """Rotation about the y axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def about_x(degrees: float) -> Array:
    """Rotation about the x axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def about_z(degrees: float) -> Array:
    """Rotation about the z axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# ---------------------------------------------------------------------- flat things, materials, lights, the camera


def rectangle(corner: Vector, along: Vector, across: Vector, bsdf: dict[str, Any], **more: Any) -> dict[str, Any]:
    """The parallelogram of two edges from a corner, looking along ``along`` x ``across``."""
    import mitsuba as mi

    u, v = np.array(along) / 2, np.array(across) / 2
    normal = np.cross(u, v)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = u, v
    matrix[:3, 2] = normal / np.linalg.norm(normal)
    matrix[:3, 3] = np.array(corner) + u + v
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf, **more}


def rgb(*value: float) -> dict[str, Any]:
    """A colour."""
    return {"type": "rgb", "value": list(value)}


def diffuse(*value: float) -> dict[str, Any]:
    """A matte colour, on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(*value)}}


def glass(index: float = 1.5, *tint: float) -> dict[str, Any]:
    """Clear or tinted glass."""
    colour = {"specular_transmittance": rgb(*tint)} if tint else {}
    return {"type": "dielectric", "int_ior": index, "ext_ior": 1.0, **colour}


def mirror(*value: float) -> dict[str, Any]:
    """A perfect mirror."""
    reflectance = rgb(*(value or (0.92, 0.92, 0.92)))
    return {"type": "twosided", "bsdf": {"type": "conductor", "material": "none", "specular_reflectance": reflectance}}


def metal(material: str, alpha: float = 0.0) -> dict[str, Any]:
    """A metal, polished or rough, on both sides."""
    rough = {"type": "roughconductor", "distribution": "ggx", "alpha": alpha}
    inner = rough if alpha > 0.0 else {"type": "conductor"}
    return {"type": "twosided", "bsdf": inner | {"material": material}}


def glazed(*value: float) -> dict[str, Any]:
    """A colour under a clear smooth coat: china, lacquer."""
    return {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": rgb(*value)}}


def picture(pixels: Array, repeat: tuple[float, float] = (1.0, 1.0)) -> dict[str, Any]:
    """A texture of (height, width, 3) reflectances."""
    import mitsuba as mi

    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(pixels.astype(np.float32)),
        "raw": True,
        "to_uv": mi.ScalarTransform4f().scale([*repeat, 1.0]),
    }


def lamp(centre: Vector, radius: float, *radiance: float) -> dict[str, Any]:
    """A glowing ball."""
    return {
        "type": "sphere",
        "center": list(centre),
        "radius": radius,
        "bsdf": {"type": "diffuse", "reflectance": rgb(0.0, 0.0, 0.0)},
        "emitter": {"type": "area", "radiance": rgb(*radiance)},
    }


def camera(origin: Vector, target: Vector, fov: float) -> dict[str, Any]:
    """A pinhole camera, 1024x768, as the thesis's pictures; ``fov`` is across."""
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "x",
        "near_clip": 0.05,
        "to_world": mi.ScalarTransform4f().look_at(list(origin), list(target), [0, 1, 0]),
        "sampler": {"type": "independent", "sample_count": 64},
        "film": {
            "type": "hdrfilm",
            "width": 1024,
            "height": 768,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
    }


def planks(rng: np.random.Generator, boards: int = 12, *, tone: Vector, length: int = 512) -> Array:
    """Wooden boards side by side, each with its own tone, grain and joint: (512, length, 3) reflectances."""
    height = 512
    rows = np.arange(height) * boards // height
    shade = rng.uniform(0.75, 1.15, boards)[rows][:, None]
    grain = rng.normal(0.0, 1.0, (height, 1)) * 0.045 + rng.normal(0.0, 1.0, (height, 8)).repeat(length // 8, 1) * 0.02
    value = np.broadcast_to(shade * (1.0 + grain), (height, length)).copy()
    value[(np.arange(height) * boards % height) < boards * 2] *= 0.45
    for board in range(boards):
        joint = rng.integers(0, length)
        value[rows == board, joint : joint + 2] *= 0.45
        value[rows == board, joint:] *= rng.uniform(0.85, 1.1)
    return np.clip(value[..., None] * np.array(tone), 0.02, 0.9)
