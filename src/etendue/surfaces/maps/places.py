"""The surfaces of a scene divided into cells, and particles on them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SceneError, is_whole, logger, use_variant
from etendue.scene import RenderSpace, graph

from ..errors import SurfaceError
from ..patches import Patches
from ..places import PatchSurfaces
from ..readers.meshfiles import broken_faces
from ..readers.scenepatches import loaded_scene
from ..readers.tessellation import tessellate
from .protocol import SurfaceParticles, normals_on_device, points_on_device

if TYPE_CHECKING:
    import mitsuba as mi

Index = NDArray[np.int64]

#: Sides of the polygon that replaces a circle: its area is too small by 0.2 %.
_SEGMENTS = 64
#: Distance before a particle at which the ray to it starts, relative to 1 + its largest coordinate: rounding moves a
#: position by 2^-24 of this coordinate, and a grazing ray hits the surface some hundred times that distance away.
_BEFORE = 1e-4
#: Least share of the particles that must lie on the surfaces.
_ON_SURFACES = 0.9


class MapSurfaces:
    """The surfaces of a scene that can have a map: those with a material that scatters into all directions.

    Parameters
    ----------
    scene: an argument, or a result, of :func:`etendue.scene.load`.
    cells: approximate number of cells; a cell is a triangle or quadrilateral of at most the area of all surfaces
        divided by this number. Small faces are not divided, so there may be more cells.

    Raises :class:`UnsupportedError` for shapes without faces or parameters (curves, instances), :class:`SceneError` if
    no surface can have a map, :class:`SurfaceError` for an invalid number of cells.

    Attributes
    ----------
    whole, patches: the surfaces before and after the division. ``shapes`` of patches are indices in ``scene.shapes()``.
    """

    def __init__(self, scene: Any, cells: int = 20_000) -> None:
        use_variant()
        if not is_whole(cells) or cells < 1:
            raise SurfaceError(f"the number of cells of a map is a whole number above zero, not {cells!r}")
        self.scene, self.space = loaded_scene(scene)
        self.whole = map_patches(self.scene, self.space)
        self.patches = self.whole.subdivided(float(self.whole.areas.sum()) / cells)
        assert self.patches.shapes is not None
        #: (n,) index in ``scene.shapes()`` of the shape of each cell.
        self.shapes: Index = self.patches.shapes

    @cached_property
    def places(self) -> PatchSurfaces:
        """Finds cells by points."""
        return PatchSurfaces(self.patches)

    def cell_of(self, p: mi.Point3f, n: mi.Normal3f) -> Index:
        """(m,) the cell at points in render space, on the side of the normals; -1 where there is none."""
        place = self.places.find(p, n, True, self.space)
        dr.eval(place.side, place.found)
        return np.where(np.array(place.found), self.places.patch[np.array(place.side)], -1)

    def located(self, hits: SurfaceParticles) -> Located:
        """Particles with the normals and shapes of this scene, found by a short ray along the last part of the flight.

        Particles that are not finite or lie on no surface are left out with a warning, those on a surface that cannot
        have a map without one. Raises :class:`SurfaceError` if no particle is left, and if so many lie on no surface
        that they must be of another scene.
        """
        if not len(hits):
            raise SurfaceError("there are no particles, so no map: trace more light paths")
        position, direction, power = (np.asarray(x, np.float64) for x in (hits.position, hits.direction, hits.power))
        sound = np.isfinite(position).all(1) & np.isfinite(direction).all(1) & np.isfinite(power).all(1)
        sound &= (power >= 0).all(1)
        kept = np.flatnonzero(sound)
        found = on_surfaces(self.scene, self.space, position[kept], direction[kept])
        if np.count_nonzero(found.hit) < _ON_SURFACES * len(hits):
            raise SurfaceError(
                f"only {np.count_nonzero(found.hit)} of {len(hits)} particles lie on the surfaces of this scene: they "
                "are of another one, or the scene has changed; trace them again"
            )
        mapped = np.isin(found.shape, self.shapes) & found.hit
        if len(kept) < len(hits) or not found.hit.all():
            lost = len(hits) - np.count_nonzero(found.hit)
            logger.warning("%d of %d particles are damaged or on no surface; they are left out", lost, len(hits))
        if not mapped.any():
            raise SurfaceError("no particle lies on a surface that can have a map; a mirror or glass has none")
        kept = kept[mapped]
        path = np.asarray(hits.path, np.uint32)
        at = found.position[mapped], found.normal[mapped], found.shape[mapped]
        return Located(*at, power[kept], path[kept], direction[kept])

    def uploaded(self, located: Located) -> tuple[mi.Point3f, mi.Normal3f]:
        """Positions and normals on the device."""
        return points_on_device(located.position), normals_on_device(located.normal)

    def warn_of_dark(self, seen: Index) -> None:
        """Warn of shapes on which no particle lies. seen: indices of shapes."""
        dark = np.setdiff1d(self.shapes, seen)
        if len(dark):
            names = [self.patches.shape_names[k] for k in dark[:3]]
            more = f" and {len(dark) - 3} more" if len(dark) > 3 else ""
            logger.warning("no particles on %s%s: the map is black there", ", ".join(names), more)


@dataclass(frozen=True)
class Located:
    """Particles on surfaces. ``position``, ``normal``, ``power``, ``direction`` of flight: (n, 3), the first in render
    space, the second on the side of arrival; ``shape``: index in ``scene.shapes()``, ``path``: (n,)."""

    position: Array
    normal: Array
    shape: Index
    power: Array
    path: NDArray[np.uint32]
    direction: Array

    def __len__(self) -> int:
        return len(self.path)

    def only(self, chosen: NDArray[Any]) -> Located:
        """The chosen particles."""
        return Located(**{one.name: getattr(self, one.name)[chosen] for one in fields(self)})


@dataclass(frozen=True)
class _OnSurfaces:
    position: Array
    normal: Array
    shape: Index
    hit: NDArray[np.bool_]


def on_surfaces(
    scene: mi.Scene, space: RenderSpace, positions: Array, directions: Array, reach: float = 0.0
) -> _OnSurfaces:
    """Surfaces at positions (m, 3) in the scene's coordinates, hit along directions (m, 3): at most ``reach``, or the
    tolerance for rounding if that is larger, before or behind the positions."""
    import mitsuba as mi

    local = space.from_scene(positions)
    if not len(local):
        return _OnSurfaces(local, local, np.zeros(0, np.int64), np.zeros(0, bool))
    p, d = points_on_device(local), dr.normalize(mi.Vector3f(normals_on_device(directions)))
    before = dr.maximum(_BEFORE * (1 + dr.max(dr.abs(p))), reach * space.scale)
    ray = mi.Ray3f(p - before * d, d)
    ray.maxt = 2 * before
    si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False)
    normal = dr.select(dr.dot(si.n, d) > 0, -si.n, si.n)
    shape, hit = dr.reinterpret_array(mi.UInt32, si.shape), si.is_valid()
    dr.eval(normal, shape, hit)
    number = {int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]): k for k, s in enumerate(scene.shapes())}
    ids = np.array(shape)
    table = np.full(int(max(ids.max(), *number)) + 1, -1)
    table[list(number)] = list(number.values())
    return _OnSurfaces(local, np.array(normal, dtype=np.float64).T, table[ids], np.array(hit))


def map_patches(scene: mi.Scene, space: RenderSpace) -> Patches:
    """A patch without material for each face of those shapes whose material has a smooth component."""
    import mitsuba as mi

    vertices, faces, shapes, sheets, offset = [], [], [], [], 0
    for number, shape in enumerate(scene.shapes()):
        flags = shape.bsdf().flags()
        if not mi.has_flag(flags, mi.BSDFFlags.Smooth):
            continue
        points, corners, _ = tessellate(shape, _SEGMENTS)
        corners = np.delete(corners, broken_faces(points, corners, graph.describe(shape, "shape"), ""), axis=0)
        vertices.append(points)
        faces.append(corners + offset)
        shapes.append(np.full(len(corners), number))
        sheets.append(np.full(len(corners), mi.has_flag(flags, mi.BSDFFlags.BackSide)))
        offset += len(points)
    if not faces:
        raise SceneError("the scene has no surface that can have a map; mirrors and glass have none")
    patches = Patches(space.to_scene(np.concatenate(vertices)), np.concatenate(faces), two_sided=np.concatenate(sheets))
    patches.shapes = np.concatenate(shapes)[patches.labels]
    patches.shape_names = tuple(graph.name(item) or f"shape {k}" for k, item in enumerate(scene.shapes()))
    return patches
