r"""Kernel maps, built in passes at the centres of cells: fixed kernels, and variable ones after a pilot.

With the particles i of power Phi_i at distances d_i along their surface, and kernels of bandwidth h_i,

.. math:: E(y) = \frac{\sum_i \Phi_i K(d_i / h_i) / h_i^2}{\int K(d / h) / h^2 dA}

in which the integral over the surface around y is 1 away from edges, 1/2 at an edge, 1/4 in a corner
(``renormalise``). ``linear`` fits a plane to the density, so that a slope at the border causes no bias [Jones 1993;
Walter 1998]; ``reflect`` mirrors particles at the borders of flat rectangles.

A particle counts only on its own shape, where normals agree and it lies near the tangent plane: no light leaks to the
other side of a sheet or around a corner. A variable kernel has at each cell the bandwidth h (E_p / g)^-1/2, with a
pilot estimate E_p and its geometric mean g [Abramson 1982; Leeson 2001, sec. 5.7.2].
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Literal, get_args

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, copied_to_device
from etendue.density import KdTree, Kernel, kernel_of, relative_widths

from ..errors import SurfaceError
from .cells import GROUPS, PatchMap, check_groups, group_of, mean_of_groups
from .places import Located, MapSurfaces
from .points import Apart, merged, quadrature
from .protocol import SurfaceParticles, normals_on_device, points_on_device
from .rectangles import Mirror

if TYPE_CHECKING:
    import mitsuba as mi

Index = NDArray[np.int64]
Correction = Literal["none", "renormalise", "linear", "reflect"]

#: Least cosine between the normals of a place and of a particle that counts there, and greatest height of the particle
#: above the tangent plane of the place, in bandwidths.
SAME_SIDE, FLAT = 0.8, 0.3
#: Edge, in reaches of a kernel, of the grid in which points of the integral over the surface become one.
_POINT = 1 / 8
#: Components of unit normals of cells that are searched together differ by at most this much.
_ALIKE = 0.8
#: Tolerance of their angles, for single precision.
_ROUNDING = 1e-3
#: Least reach of a kernel in cells; with less, the integral over the surface is inaccurate.
_LEAST_REACH = 2.0
#: Least and greatest bandwidth of a variable kernel, relative to that of a fixed one.
_NARROWEST, _WIDEST = 0.1, 4.0
#: Least determinant of the moments of a kernel, in bandwidths; that of a whole disc is 1/36.
_SINGULAR = 1e-5


class KernelBuilder:
    """Adds kernels of particles at the centres of cells, pass after pass.

    Parameters
    ----------
    surfaces: the cells.
    bandwidth: h of the kernel, one number or one for each cell, in the scene's units; see :func:`rule_bandwidths` and
        :func:`variable_bandwidths`. It is raised where the kernel would reach less than two cells.
    kernel: a :class:`etendue.density.Kernel` or its name.
    boundary: ``renormalise``, ``linear``, ``reflect`` (on flat rectangles; elsewhere ``renormalise``) or ``none``.
    groups: groups of light paths whose spread gives the standard error.

    Raises :class:`SurfaceError` for invalid arguments.
    """

    def __init__(
        self,
        surfaces: MapSurfaces,
        bandwidth: ArrayLike,
        kernel: Kernel | str = "epanechnikov",
        boundary: Correction = "renormalise",
        groups: int = GROUPS,
    ) -> None:
        if boundary not in get_args(Correction):
            raise SurfaceError(f"boundary is one of {', '.join(get_args(Correction))}, not {boundary!r}")
        patches = surfaces.patches
        h = np.asarray(bandwidth, dtype=np.float64)
        if h.shape not in ((), (len(patches),)) or not (np.isfinite(h).all() and (h > 0).all()):
            raise SurfaceError(f"a bandwidth is a number above zero, or one for each of {len(patches)} cells")
        self.surfaces, self.boundary, self.groups = surfaces, boundary, check_groups(groups)
        self.kernel = kernel_of(kernel)
        least = _LEAST_REACH * np.sqrt(patches.areas) / self.kernel.reach
        #: (n,) h at each cell.
        self.bandwidths: Array = np.maximum(np.broadcast_to(h, (len(patches),)), least)
        self._mirror = Mirror(surfaces.whole, surfaces.space) if boundary == "reflect" else None
        self._frames = _Frames(surfaces)
        self._moments = 3 if boundary == "linear" else 1
        #: (groups, n, moments, 3) W/m^2, before the correction.
        self.sums = np.zeros((groups, len(patches), self._moments, 3))
        self.particles = 0
        self._seen: set[int] = set()

    def add(self, hits: SurfaceParticles) -> None:
        """Add particles; raises as :meth:`MapSurfaces.located`."""
        located = self.surfaces.located(hits)
        cell = self.surfaces.cell_of(*self.surfaces.uploaded(located))
        located, cell = located.only(cell >= 0), cell[cell >= 0]
        self._seen |= set(np.unique(located.shape).tolist())
        self.particles += len(located)
        group = group_of(located.path, self.groups)
        for number in range(self.groups):
            part, h = located.only(group == number), self.bandwidths[cell[group == number]]
            if not len(part):
                continue
            if self._mirror is not None:
                part, h = self._mirror.images(part, h, self.kernel.reach)
            self.sums[number] += self._frames.sums(part, h, self.kernel, self._moments)

    def build(self, smooth: bool = True, tell: Callable[[float], object] = lambda share: None) -> PatchMap:
        """The map of all particles so far; warns of surfaces without any. Raises :class:`SurfaceError` for none.
        ``tell`` receives the share of the integrals over the surface that is done.

        Values of ``linear`` may be below zero in the dark beside light: if they were clipped, the mean of maps would
        be too bright there.
        """
        if not self.particles:
            raise SurfaceError("there are no particles, so no map: add some first")
        self.surfaces.warn_of_dark(np.array(sorted(self._seen)))
        values, errors = mean_of_groups(np.einsum("nm,gnmc->gnc", self._weights(tell), self.sums))
        return PatchMap(self.surfaces.places, values, errors, smooth=smooth, kind="kernel", space=self.surfaces.space)

    def _weights(self, tell: Callable[[float], object] = lambda share: None) -> Array:
        """(n, moments) factors of the sums, from the same sums over the surface instead of the particles. Cells without
        light have none."""
        n = len(self.bandwidths)
        if self.boundary == "none":
            return np.ones((n, 1))
        points, owner = quadrature(self.surfaces.patches, self.surfaces.space)
        h = self.bandwidths[owner]
        if self._mirror is not None:
            points, h = self._mirror.images(points, h, self.kernel.reach)
        few, chosen = merged(points, points.shape, h, _POINT * self.kernel.reach * self.surfaces.space.scale)
        moments = 6 if self.boundary == "linear" else 1
        found = np.zeros((n, moments))
        done, lit = 0, self.sums.any(axis=(0, 2, 3))
        for cells, near in self._frames.alike(np.flatnonzero(lit), few):
            part, widths = few.only(near), h[chosen[near]]
            found[cells] = self._frames.sums(part, widths, self.kernel, moments, cells)[:, :, 0]
            done += len(cells)
            tell(done / np.count_nonzero(lit))
        share = found[:, 0]
        plain = np.divide(1.0, share, out=np.zeros(n), where=share > 0)
        if self.boundary != "linear":
            return plain[:, None]
        u, v, uu, uv, vv = found[:, 1:].T
        system = np.moveaxis(np.array([[share, u, v], [u, uu, uv], [v, uv, vv]]), 2, 0) * plain[:, None, None]
        # Lengths in bandwidths of the cell, so that all numbers are about 1.
        unit = np.ones((n, 3))
        unit[:, 1:] = 1 / self._frames.apart.length(self.bandwidths)[:, None]
        system *= unit[:, :, None] * unit[:, None, :]
        # Without a regular system there is no plane: the cell keeps the plain correction.
        sound = np.linalg.det(system) > _SINGULAR
        weights = np.zeros((n, 3))
        weights[:, 0] = plain
        if sound.any():
            first = np.broadcast_to([[1.0], [0.0], [0.0]], (int(sound.sum()), 3, 1))
            solved = np.linalg.solve(system[sound], first)[:, :, 0]
            weights[sound] = solved * unit[sound] * plain[sound, None]
        return weights


def variable_bandwidths(pilot: PatchMap, bandwidth: ArrayLike) -> Array:
    """(n,) bandwidths of cells by a pilot estimate on them: ``h (E / g)^-1/2``, within 0.1 and 4 h."""
    light, areas = pilot.values.mean(axis=1), pilot.surfaces.patches.areas
    lit = light > 0
    if not lit.any():
        raise SurfaceError("the pilot of a variable kernel is black everywhere: add particles")
    factor = np.full(len(light), _WIDEST)
    factor[lit] = np.clip(relative_widths(light[lit], light[lit] * areas[lit]), _NARROWEST, _WIDEST)
    return np.broadcast_to(np.asarray(bandwidth, dtype=np.float64), (len(light),)) * factor


class _Frames:
    """Centres of the cells with tangents, at which kernels are added; lengths are in radii of the scene."""

    def __init__(self, surfaces: MapSurfaces) -> None:
        import mitsuba as mi

        patches, shapes = surfaces.patches, surfaces.shapes
        self._normals = patches.normals
        self.apart = Apart(patches, surfaces.space, shapes)
        # Neighbouring lanes visit the same nodes of a tree if they are close in space, as the cells of a face are.
        centres = surfaces.space.from_scene(patches.centres)
        self._p = points_on_device(self.apart.located(centres, self.apart.number(shapes)))
        self._n = normals_on_device(patches.normals)
        self._s, self._t = mi.coordinate_system(self._n)
        self._shape = copied_to_device(mi.Float, shapes.astype(np.float32))
        dr.eval(self._s, self._t)

    def alike(self, cells: Index, at: Located) -> Iterator[tuple[Index, Index]]:
        """``cells`` in groups of similar normals, and of the points ``at`` those whose normals agree with any of the
        group: where a mesh faces all ways, most of the points near a cell do not count there."""
        normals = self._normals[cells]
        group = np.unique(np.rint(normals / _ALIKE), axis=0, return_inverse=True)[1].reshape(-1)
        for number in range(group.max(initial=-1) + 1):
            ours = np.flatnonzero(group == number)
            axis = normals[ours].mean(axis=0)
            axis /= np.linalg.norm(axis)
            widest = np.arccos(np.clip(normals[ours] @ axis, -1, 1)).max() + np.arccos(SAME_SIDE) + _ROUNDING
            yield cells[ours], np.flatnonzero(at.normal @ axis >= np.cos(min(widest, np.pi)) - _ROUNDING)

    def sums(self, at: Located, bandwidths: Array, kernel: Kernel, moments: int, cells: Index | None = None) -> Array:
        """(n, moments, 3) sums of powers times kernels of ``bandwidths`` (m,), per area of the scene, times 1, u, v,
        u u, u v, v v: tangential offsets in radii of the scene. ``cells``: of these only."""
        import mitsuba as mi

        centre, normal, tangents, shape = self._p, self._n, [self._s, self._t], self._shape
        if cells is not None:
            row = copied_to_device(mi.UInt32, cells.astype(np.uint32))
            centre, normal, *tangents, shape = (dr.gather(type(x), x, row) for x in (centre, normal, *tangents, shape))

        h = self.apart.length(bandwidths)
        places = self.apart.located(at.position, self.apart.number(at.shape))
        tree = KdTree(points_on_device(places), reach=_floats(h * kernel.reach))
        scaled = at.power * (kernel.normalisation(2) / bandwidths**2)[:, None]
        order = np.array(tree.order)
        rows = np.zeros((len(order), 12), np.float32)
        rows[:, :3], rows[:, 3] = places[order], h[order] ** -2.0
        rows[:, 4:7], rows[:, 7] = at.normal[order], at.shape[order]
        rows[:, 8:11] = scaled[order]
        packed = copied_to_device(mi.Float, rows)
        limit = kernel.reach**2

        def add(place: mi.UInt32, distance: mi.Float, state: tuple[mi.Color3f, ...]) -> tuple[mi.Color3f, ...]:
            x, n, c = (dr.gather(mi.Vector4f, packed, 3 * place + k) for k in range(3))
            offset = mi.Vector3f(x.x, x.y, x.z) - centre
            height = dr.dot(normal, offset)
            counts = (dr.dot(normal, mi.Vector3f(n.x, n.y, n.z)) > SAME_SIDE) & (n.w == shape)
            counts &= dr.square(height) * x.w <= FLAT * FLAT
            weight = dr.select(counts, kernel.profile(dr.minimum(distance * x.w, limit)), 0.0)
            value = mi.Color3f(c.x, c.y, c.z) * weight
            u, v = (dr.dot(tangent, offset) for tangent in tangents)
            factors = (1.0, u, v, u * u, u * v, v * v)[:moments]
            return tuple(total + value * factor for total, factor in zip(state, factors, strict=True))

        start = tuple(dr.zeros(mi.Color3f, dr.width(centre)) for _ in range(moments))
        dr.eval(centre, normal, tangents, shape)
        found = tree.covering(centre, start, add)
        dr.eval(found)
        return np.stack([np.array(part, dtype=np.float64).T for part in found], axis=1)


def _floats(values: Array) -> mi.Float:
    import mitsuba as mi

    return copied_to_device(mi.Float, values.astype(np.float32))
