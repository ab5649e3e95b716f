"""Meshes made by code for the bundled scenes: surfaces of revolution, height fields and flat-faced solids."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import mitsuba as mi

Points = NDArray[np.float64]
Faces = NDArray[np.int64]
Mesh = tuple[Points, Faces]


@dataclass(frozen=True)
class MeshDescription:
    """A mesh of a bundled scene or a model before it is built: (n, 3) points, (m, 3) faces and, for smooth shading,
    (n, 3) normals; ``emitter``: radiance of a mesh that is a light; (n, 2) texture coordinates, with v down, and (n, 3)
    values of the attribute ``vertex_color``; ``interior``: id of the scene's medium inside. A built mesh cannot be
    written as XML."""

    name: str
    points: Points
    faces: Faces
    bsdf: dict[str, Any]
    normals: Points | None = None
    emitter: dict[str, Any] | None = None
    coordinates: Points | None = None
    colours: Points | None = None
    interior: str = ""

    def build(self, interior: mi.Medium | None = None) -> mi.Mesh:
        """The mesh with its material, light and medium."""
        import mitsuba as mi

        properties = mi.Properties()
        properties["mesh_bsdf"] = mi.load_dict(self.bsdf)
        if self.emitter is not None:
            properties["mesh_emitter"] = mi.load_dict({"type": "area", "radiance": self.emitter})
        if interior is not None:
            properties["interior"] = interior
        return self._mesh(properties)

    def write(self, path: Path) -> None:
        """Write the surface alone as PLY, in the order and precision of :meth:`build`."""
        import mitsuba as mi

        self._mesh(mi.Properties()).write_ply(str(path))

    def of_file(self, path: Path) -> dict[str, Any]:
        """The plugin that reads the file of :meth:`write`."""
        plugin = {"type": "ply", "filename": str(path), "face_normals": self.normals is None, "bsdf": self.bsdf}
        if self.interior:
            plugin["interior"] = {"type": "ref", "id": self.interior}
        return plugin if self.emitter is None else plugin | {"emitter": {"type": "area", "radiance": self.emitter}}

    def _mesh(self, properties: mi.Properties) -> mi.Mesh:
        import mitsuba as mi

        is_smooth = self.normals is not None
        result = mi.Mesh(
            self.name,
            len(self.points),
            len(self.faces),
            has_vertex_normals=is_smooth,
            has_vertex_texcoords=self.coordinates is not None,
            props=properties,
        )
        parameters = mi.traverse(result)
        parameters["vertex_positions"] = np.ascontiguousarray(self.points, np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(self.faces, np.uint32).ravel()
        if is_smooth:
            parameters["vertex_normals"] = np.ascontiguousarray(self.normals, np.float32).ravel()
        if self.coordinates is not None:
            parameters["vertex_texcoords"] = np.ascontiguousarray(self.coordinates, np.float32).ravel()
        parameters.update()
        if self.colours is not None:
            result.add_attribute("vertex_color", 3, np.ascontiguousarray(self.colours, np.float32).ravel())
        return result


def box(low: ArrayLike, high: ArrayLike, cells: ArrayLike = 1, inward: bool = False) -> Mesh:
    """Vertices (v, 3) and quadrilaterals (m, 4) of a box, cut into ``cells`` along each axis, a number or three.

    Its faces look outward, or ``inward`` for a room. Walls are in the order low x, high x, low y ..., each with its own
    vertices, at the same positions as those of its neighbours.
    """
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    cuts = np.broadcast_to(np.asarray(cells, dtype=np.int64), 3)
    lines = [np.linspace(low[axis], high[axis], cuts[axis] + 1) for axis in range(3)]
    walls = []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        j, k = (x.ravel() for x in np.meshgrid(np.arange(cuts[b] + 1), np.arange(cuts[c] + 1), indexing="ij"))
        first = (j * (cuts[c] + 1) + k)[(j < cuts[b]) & (k < cuts[c])]
        quads = np.stack([first, first + cuts[c] + 1, first + cuts[c] + 2, first + 1], axis=1)
        for end in range(2):
            points = np.empty((len(j), 3))
            points[:, axis], points[:, b], points[:, c] = lines[axis][-end], lines[b][j], lines[c][k]
            walls.append((points, quads if (end == 1) != inward else quads[:, ::-1]))
    return joined(*walls)


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def grid(rows: int, columns: int) -> Faces:
    """Triangles of a grid of points, row by row, which look along (row axis) x (column axis)."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([a, a + columns, a + columns + 1], -1)
    return np.concatenate([lower, np.stack([a, a + columns + 1, a + 1], -1)])


def cuboids(lower: Points, upper: Points) -> tuple[Points, Faces]:
    """Boxes with these corners, (n, 3) each, as one mesh whose faces point outwards."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], bool)
    points = np.where(corner[None], np.asarray(upper)[:, None], np.asarray(lower)[:, None])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = np.array([side for a, b, c, d in sides for side in ((a, b, c), (a, c, d))])
    faces = 8 * np.arange(len(points))[:, None, None] + triangles[None]
    return points.reshape(-1, 3), faces.reshape(-1, 3)


def lathe(profile: Points, segments: int, closed: bool) -> tuple[Points, Faces, Points]:
    """Surface of revolution of a profile of (radius, height) points about the y axis; returns points, faces and smooth
    normals.

    The solid is to the left of the profile's direction in the (radius, height) plane, so that faces and normals point
    outwards. A profile that is not ``closed`` may begin and end on the axis (radius 0).
    """
    n = len(profile)
    angle = 2.0 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.cos(angle), np.zeros(segments), np.sin(angle)], -1)
    up = np.array([0.0, 1.0, 0.0])
    points = profile[:, None, :1] * ring + profile[:, None, 1:] * up

    # Normal of the profile: its tangent turned to the right.
    if closed:
        tangent = np.roll(profile, -1, 0) - np.roll(profile, 1, 0)
    else:
        tangent = np.gradient(profile, axis=0)
        for end, sign in ((0, 1.0), (-1, -1.0)):
            if profile[end, 0] < 1e-9:  # the surface crosses the axis horizontally
                tangent[end] = [sign, 0.0]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normals = tangent[:, None, 1:] * ring - tangent[:, None, :1] * up

    i = np.arange(n if closed else n - 1)[:, None]
    j = np.arange(segments)[None, :]
    a, b = i * segments + j, i * segments + (j + 1) % segments
    c, d = (i + 1) % n * segments + j, (i + 1) % n * segments + (j + 1) % segments
    lower, upper = np.stack([a, d, b], -1), np.stack([a, c, d], -1)
    if not closed:  # at the axis one triangle of each quadrilateral has no area
        lower, upper = lower[int(profile[0, 0] < 1e-9) :], upper[: n - 1 - int(profile[-1, 0] < 1e-9)]
    faces = np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    return points.reshape(-1, 3), faces, normals.reshape(-1, 3)


def smooth(corners: Points, per_corner: int, closed: bool) -> Points:
    """A curve of quadratic B-spline pieces that rounds every corner of a polygon; an open curve keeps its ends."""
    t = np.linspace(0.0, 1.0, per_corner, endpoint=False)[:, None]
    before, after = np.roll(corners, 1, 0), np.roll(corners, -1, 0)
    first, last = (before + corners) / 2, (corners + after) / 2
    if not closed:
        first[1], last[-2] = corners[0], corners[-1]
        corners, first, last = corners[1:-1], first[1:-1], last[1:-1]
    pieces = [(1 - t) ** 2 * f + 2 * t * (1 - t) * c + t**2 * e for f, c, e in zip(first, corners, last, strict=True)]
    return np.concatenate(pieces if closed else [*pieces, last[-1:]])


def built(described: Mapping[str, Any]) -> dict[str, Any]:
    """A scene's dictionary with its meshes built. Media inside of them become objects, too, because a built mesh cannot
    refer to a description."""
    import mitsuba as mi

    inside = {value.interior for value in described.values() if isinstance(value, MeshDescription)} - {""}
    media = {name: mi.load_dict(described[name]) for name in inside}

    def made(value: Any) -> Any:
        if isinstance(value, MeshDescription):
            return value.build(media.get(value.interior))
        if not isinstance(value, dict):
            return value
        if value.get("type") == "ref" and value.get("id") in media:
            return media[value["id"]]
        return {key: made(part) for key, part in value.items()}

    return {name: made(value) for name, value in described.items() if name not in media}


def height_field(
    height: Callable[[Points, Points], Points], x: tuple[float, float], z: tuple[float, float], cells: tuple[int, int]
) -> tuple[Points, Faces, Points]:
    """The surface y = height(x, z) over a rectangle, normals up; returns points, faces and smooth normals."""
    grid_x, grid_z = np.meshgrid(np.linspace(*x, cells[0] + 1), np.linspace(*z, cells[1] + 1), indexing="ij")
    step = 1e-4
    slope_x = (height(grid_x + step, grid_z) - height(grid_x - step, grid_z)) / (2 * step)
    slope_z = (height(grid_x, grid_z + step) - height(grid_x, grid_z - step)) / (2 * step)
    normals = np.stack([-slope_x, np.ones_like(slope_x), -slope_z], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points = np.stack([grid_x, height(grid_x, grid_z), grid_z], -1)
    row = cells[1] + 1
    a = (np.arange(cells[0])[:, None] * row + np.arange(cells[1])[None, :]).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + row + 1], -1), np.stack([a, a + row + 1, a + row], -1)])
    return points.reshape(-1, 3), faces, normals.reshape(-1, 3)


def brilliant(radius: float, crown: float, pavilion: float, sides: int) -> tuple[Points, Faces]:
    """A cut gemstone that stands on its table: polygons of table and girdle, connected by facets, and a tip.

    Every facet has its own vertices, so that it is shaded flat.
    """
    angle = 2 * np.pi * np.arange(sides) / sides
    half = angle + np.pi / sides

    def ring(r: float, y: float, phi: NDArray[np.float64]) -> Points:
        return np.stack([r * np.cos(phi), np.full(sides, y), r * np.sin(phi)], -1)

    table, girdle = ring(0.58 * radius, 0.0, angle), ring(radius, crown, half)
    waist = ring(0.93 * radius, crown + 0.3 * pavilion, angle)
    tip, centre = np.array([0.0, crown + pavilion, 0.0]), np.zeros(3)
    triangles = []
    for i in range(sides):
        j, h = (i + 1) % sides, (i - 1) % sides
        triangles += [
            (centre, table[i], table[j]),
            (table[j], table[i], girdle[i]),
            (table[i], girdle[h], girdle[i]),
            (girdle[i], girdle[h], waist[i]),
            (girdle[i], waist[i], waist[j]),
            (waist[i], tip, waist[j]),
        ]
    points = np.array(triangles).reshape(-1, 3)
    return points, np.arange(len(points)).reshape(-1, 3)
