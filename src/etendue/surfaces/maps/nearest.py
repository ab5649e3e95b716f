r"""Maps by the k nearest particles, which are all in memory.

.. math:: E(x) = \frac{\sum_i \Phi_i K(d_i^2 / r^2)}{\int K(d^2 / r^2) dA}

over the particles within the distance r of the k-th one [Jensen 1996; Leeson 2001, sec. 3.5, 5.7.2]. The k-th particle
defines the disc and is not counted. Neighbours are particles on the same side of the same shape. As in kernel maps,
they count only near the tangent plane, and the integral runs over the surface within the disc, so that edges are not
dark. The integral is a sum over points of the surfaces, as many as a disc of mean size needs; for the much smaller
discs of a caustic, the area of the whole disc is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from etendue.core import copied_to_device, free_memory, is_whole
from etendue.density import KdTree, Kernel, kernel_of
from etendue.scene import Material

from ..errors import SurfaceError
from ..patches import Patches
from .kernels import FLAT, SAME_SIDE
from .places import Located, MapSurfaces
from .points import OWN, Apart, Index, merged, quadrature
from .protocol import Irradiance, SurfaceParticles, points_on_device

if TYPE_CHECKING:
    import mitsuba as mi

#: Bytes of a particle in memory: arrays on the host, the tree and its payload, and temporary arrays for building them.
PARTICLE_BYTES = 350
#: Least number of quadrature points in a whole disc for the integral over the surface: four a cell.
_LEAST_POINTS = 24.0
#: Cells for this integral in a disc of mean size, and least and greatest number of cells of the scene.
_CELLS, _LEAST_CELLS, _MOST_CELLS = 12, 1000, 400_000
#: Factor on the squared distance of the farthest particle, so that it is not inside.
_INSIDE = 1.0 - 1e-6


class NearestMap:
    """Irradiance from the ``k`` nearest particles.

    Parameters
    ----------
    surfaces: the surfaces; the number of their cells does not matter.
    hits: the particles, all in memory.
    k: 2 to the number of particles.
    kernel: weight of a particle in the disc, a :class:`etendue.density.Kernel` or its name.
    correct: whether only the part of the disc that is on the surface counts as its area.
    memory: bytes that the map may take; by default the free memory.

    The standard error is that of independent particles; hits of one path near each other are rare on fine maps. Where
    no particle counts, the irradiance is 0 and its error NaN. Where a side of a shape has fewer than ``k`` particles,
    the disc contains all of them.

    Raises :class:`SurfaceError` for invalid arguments, and if the particles do not fit into memory.
    """

    kind = "knn"

    def __init__(
        self,
        surfaces: MapSurfaces,
        hits: SurfaceParticles,
        k: int = 50,
        kernel: Kernel | str = "epanechnikov",
        correct: bool = True,
        memory: int | None = None,
    ) -> None:
        import mitsuba as mi

        if not is_whole(k) or not 2 <= k <= max(len(hits), 2):
            raise SurfaceError(f"k is a whole number from 2 to the number of particles, {len(hits)}, not {k!r}")
        room = memory if memory is not None else free_memory()
        if room is not None and len(hits) * PARTICLE_BYTES > room:
            raise SurfaceError(
                f"the nearest of {len(hits)} particles need {len(hits) * PARTICLE_BYTES / 1e9:.2g} GB, there are "
                f"{room / 1e9:.2g}: make a histogram or a kernel map, which are built in passes"
            )
        self.surfaces, self.space, self.k, self.kernel = surfaces, surfaces.space, int(k), kernel_of(kernel)
        located = surfaces.located(hits)
        cell = surfaces.cell_of(*surfaces.uploaded(located))
        located, cell = located.only(cell >= 0), cell[cell >= 0]
        surfaces.warn_of_dark(np.unique(located.shape))
        unit = surfaces.patches.sphere[1]
        keys = _side_keys(surfaces.patches)
        self._sides = Apart(surfaces.patches, self.space, keys)
        side = self._sides.number(keys[cell])
        self._particles = _Tree(located, side, self._sides)
        self._area = None
        if correct:
            count = min(max(_CELLS * len(hits) / self.k, _LEAST_CELLS), _MOST_CELLS)
            size = float(surfaces.whole.areas.sum()) / count
            fine = surfaces.whole.subdivided(size)
            self._least_area = dr.opaque(mi.Float, _LEAST_POINTS / 4 * size / unit**2)
            points, owner = quadrature(fine, self.space)
            own, edge = _side_keys(fine)[owner], np.sqrt(size) / 4 * self.space.scale
            points, chosen = merged(points, own, np.ones(len(points)), edge)
            # In units of the local frame, like the area of the disc.
            points = replace(points, power=points.power / unit**2)
            self._area = _Tree(points, self._sides.number(own[chosen]), self._sides)
        self.particles, self.correct = hits, correct
        #: For each side of a shape: the number of particles in a disc, at most k.
        there = np.bincount(side, minlength=self._sides.count)
        self._k = copied_to_device(mi.UInt32, np.minimum(there, self.k).astype(np.uint32))
        #: For each side of a face: the side of its shape.
        of_face = self._sides.number(keys[surfaces.places.patch])
        self._of_face = copied_to_device(mi.UInt32, of_face.astype(np.uint32))
        self._per_area = 1 / unit**2

    def irradiance(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True) -> Irradiance:
        """See :class:`SurfaceMap`."""
        known, (flux, squares), scale, lanes = self._density(p, n, active, lambda direction, lanes: 1.0)
        counted = lanes & dr.any(squares > 0)
        return Irradiance(flux * scale, dr.select(counted, dr.sqrt(squares) * scale, dr.nan), known)

    def reflected(
        self, si: mi.SurfaceInteraction3f, n: mi.Normal3f, material: Material, active: mi.Bool | bool = True
    ) -> tuple[mi.Color3f, mi.Bool]:
        r"""(radiance towards ``si.wi``, whether the map has a surface there): each particle is reflected by its
        direction,

        .. math:: L = \sum_i f_s(\omega_i, \omega_o) \, \Phi_i K(d_i^2 / r^2) / \int K dA,

        so that the surface may be glossy. n: geometric normals on the side of ``si.wi``."""
        import mitsuba as mi

        def brdf(direction: mi.Vector3f, lanes: mi.Bool) -> mi.Color3f:
            to_light = si.to_local(-direction)
            f = material.call(mi.BSDF.eval, mi.BSDFContext(), si, to_light, active=lanes)
            return f / dr.maximum(dr.abs(mi.Frame3f.cos_theta(to_light)), 1e-4)

        known, (light, _), scale, _ = self._density(si.p, n, active, brdf)
        return light * scale, known

    def _density(
        self,
        p: mi.Point3f,
        n: mi.Normal3f,
        active: mi.Bool | bool,
        factor: Callable[[mi.Vector3f, mi.Bool], mi.Color3f | float],
    ) -> tuple[mi.Bool, tuple[mi.Color3f, mi.Color3f], mi.Float, mi.Bool]:
        """(whether the map has a surface there; sums over particles as of :meth:`_Tree.total`; one over the area of
        the disc; lanes with a disc). ``factor``: see there."""
        import mitsuba as mi

        count = max(dr.width(p), dr.width(n), dr.width(active))
        active = mi.Bool(active) & dr.full(mi.Bool, True, count)
        place = self.surfaces.places.find(p, n, active, self.space)
        side = dr.gather(mi.UInt32, self._of_face, place.side, place.found)
        k = dr.gather(mi.UInt32, self._k, side, place.found)
        local = self._sides.placed(p, side)
        dr.eval(local, n, k, place.found)
        squared = self._particles.tree.kth_distance_squared(local, k, OWN**2, place.found & (k > 0))
        dr.eval(squared)
        lanes = place.found & (k > 0) & (squared > 0)
        sums = self._particles.total(local, n, squared, self.kernel, lanes, factor)
        area = dr.pi * squared
        if self._area is not None:
            on_surface, _ = self._area.total(local, n, squared, self.kernel, lanes, lambda direction, lanes: 1.0)
            area = dr.select((area >= self._least_area) & (on_surface.x > 0), on_surface.x, area)
        scale = dr.select(lanes & (area > 0), self._per_area / area, 0.0)
        return place.found, sums, scale, lanes


def _side_keys(patches: Patches) -> Index:
    """For each patch a number that identifies its shape and its side."""
    assert patches.shapes is not None
    is_back = np.zeros(len(patches), np.int64)
    is_back[patches.back[patches.back >= 0]] = 1
    return 2 * patches.shapes + is_back


class _Tree:
    """Points with normals and values in a kd-tree."""

    def __init__(self, at: Located, side: Index, sides: Apart) -> None:
        import mitsuba as mi

        places = sides.located(at.position, side)
        self.tree = KdTree(points_on_device(places))
        order = np.array(self.tree.order)
        rows = np.zeros((len(order), 12), np.float32)
        rows[:, :3], rows[:, 4:7] = places[order], at.normal[order]
        rows[:, 8:11] = at.power[order]
        rows[:, 3::4] = at.direction[order]
        self._packed = copied_to_device(mi.Float, rows)

    def total(
        self,
        point: mi.Point3f,
        normal: mi.Normal3f,
        squared: mi.Float,
        kernel: Kernel,
        active: mi.Bool,
        factor: Callable[[mi.Vector3f, mi.Bool], mi.Color3f | float],
    ) -> tuple[mi.Color3f, mi.Color3f]:
        """(sum of the values times the kernel on the disc of this squared radius, sum of the squares of these terms),
        over points on the same surface. ``factor(direction, lanes)``: of a point, by its direction of flight."""
        import mitsuba as mi

        def add(
            place: mi.UInt32, distance: mi.Float, state: tuple[mi.Color3f, mi.Color3f]
        ) -> tuple[mi.Color3f, mi.Color3f]:
            x, n, c = (dr.gather(mi.Vector4f, self._packed, 3 * place + k) for k in range(3))
            height = dr.dot(normal, mi.Vector3f(x.x, x.y, x.z) - point)
            counts = dr.dot(normal, mi.Vector3f(n.x, n.y, n.z)) > SAME_SIDE
            counts &= dr.square(height) <= FLAT * FLAT * squared
            term = mi.Color3f(c.x, c.y, c.z) * kernel.on_disc(dr.minimum(distance / squared, 1.0))
            term = dr.select(counts, term * factor(mi.Vector3f(x.w, n.w, c.w), counts), 0.0)
            return state[0] + term, state[1] + dr.square(term)

        start = (mi.Color3f(0.0), mi.Color3f(0.0))
        return self.tree.within(point, squared * _INSIDE, start, add, active)
