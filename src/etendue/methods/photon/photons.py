r"""Photons: traced from the lights pass by pass, and gathered around a point.

.. math:: L(x, \omega) = \frac{1}{N} \sum_j \frac{K(d_j^2 / r^2)}{\pi r^2} f_s(x, \omega_j, \omega) \, \Phi_j

over the photons j within the distance r, N light paths traced [Jensen 1996].
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import Array, logger
from etendue.density import KERNELS, HashGrid
from etendue.scene import Problem
from etendue.transport import Gather, LightVertices, LightWalk, Mis, Photons, Techniques, Vertex, unfolded

from .. import base
from ..base import PILOT_PATHS, ImageMethod, Lanes, total
from ..store import VertexRoom

#: Device memory of a photon: its record, the sorted copy, and the search structure.
_BYTES_PER_PHOTON = 48 + 48 + 32


def photon_room(problem: Problem) -> VertexRoom:
    """Room for the photons of a pass."""
    return VertexRoom(_BYTES_PER_PHOTON, LightVertices.floats_per_vertex(False), problem.memory)


@dataclass
class PhotonShot:
    """The photons of a pass."""

    vertices: LightVertices
    paths: int  #: N
    rays: float
    capacity: int


class PhotonTracer:
    """Traces the light paths of a prepared method's passes. A pilot measures how many photons a light path stores."""

    def __init__(self, method: ImageMethod, seed: int) -> None:
        self._method = method
        pilot = self._trace("pilot ", 0, seed, PILOT_PATHS, 64 * PILOT_PATHS)
        #: What a number of light paths may follow: the same in every pass, and in a run that is resumed.
        self.photons_per_path = float(pilot.vertices.wanted[0]) / PILOT_PATHS
        self.room = photon_room(method.problem)
        self.room.per_path = self.photons_per_path

    def fitting(self, wanted: int) -> int:
        """As many light paths, or fewer if their photons would not fit into memory, or they into one kernel."""
        paths = min(wanted, max(1, int(self.room.most / max(self.photons_per_path, 1e-6))), base.MOST_LIGHT_LANES)
        if paths < wanted:
            why = "one pass has no more" if paths == base.MOST_LIGHT_LANES else "their photons fill the memory"
            logger.info("%d instead of %d light paths a pass: %s", paths, wanted, why)
        return paths

    def shoot(self, iteration: int, seed: int, paths: int) -> PhotonShot:
        """The photons of a pass, all of them."""
        while True:
            shot = self._trace("", iteration, seed, paths, self.room.capacity(paths))
            if self.room.held(float(shot.vertices.wanted[0]), paths):
                return shot

    def _trace(self, role: str, iteration: int, seed: int, paths: int, capacity: int) -> PhotonShot:
        """Trace light paths and store their vertices; not yet looked at, so that nothing waits."""
        method = self._method
        mis = Mis(Techniques(emission=0, next_event=0, connection=0, splat=False), [0.0], mi.Float(1.0))
        walk = method.walker(LightWalk, camera=method.camera, mis=mis, dark=mi.Float(0.0))
        vertices = LightVertices(capacity, paths, indexed=False, connected=False)
        source = method.light_numbers(Lanes(0, paths), paths, seed, iteration, role + "light")
        rays, _ = walk.trace(paths, source, vertices)
        dr.schedule(rays)
        vertices.launch()
        return PhotonShot(vertices, paths, total(rays), capacity)


def reflected_by(
    photons: Photons, photon: mi.UInt32, vertex: Vertex, limit: mi.Float, kernel: str, active: mi.Bool
) -> mi.Color3f:
    """Reflected radiance that one photon stands for, times ``N pi r^2``; ``limit``: r^2."""
    p = photons.read(photon, active)
    distance_squared, weight = unfolded(vertex.si, photons.position(photon, active)[0], p)
    if kernel != "uniform":
        weight *= KERNELS[kernel].on_disc(dr.minimum(distance_squared / limit, 1.0))
    si = vertex.si
    value = p.fluence * vertex.bsdf.eval(mi.BSDFContext(), si, si.to_local(p.direction), active)
    return dr.select(distance_squared <= limit, value * weight, 0.0)


class PhotonGrid:
    """Photons of a pass in a grid of cells as wide as the largest radius that will be gathered in.

    Parameters
    ----------
    shot: the photons, of which ``held`` ones are gathered, at ``positions``, one lane a slot.
    radius: the largest, in scene units.
    box: corners of the scene.
    """

    def __init__(
        self,
        shot: PhotonShot,
        positions: mi.Point3f,
        held: mi.Bool,
        radius: float,
        box: tuple[Array, Array],
        kernel: str = "uniform",
    ) -> None:
        grid = HashGrid(positions, radius, *box, held)
        self._gather = Gather(grid, shot.vertices.sorted_by(grid.destination, held), (), ())
        self._paths = dr.opaque(mi.Float, shot.paths)
        self._kernel = kernel

    def reflected(
        self, vertex: Vertex, edges: mi.UInt32, limit: mi.Float, active: mi.Bool
    ) -> tuple[mi.Color3f, mi.UInt32]:
        """(radiance that a vertex reflects, photons found that it reflects) by the photons with at most ``edges``
        edges behind them within the root of ``limit``."""

        def visit(photon: mi.UInt32, state: tuple[mi.Color3f, mi.UInt32]) -> tuple[mi.Color3f, mi.UInt32]:
            flux, found = state
            value = reflected_by(self._gather.photons, photon, vertex, limit, self._kernel, active)
            return flux + value, found + dr.select(dr.all(value == 0.0), mi.UInt32(0), mi.UInt32(1))

        flux, found = self._gather.around(vertex.position, edges, visit, (mi.Color3f(0.0), mi.UInt32(0)), active, limit)
        return flux / (dr.pi * limit * self._paths), found
