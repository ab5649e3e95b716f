r"""Photons: tracing in passes, and density estimation around a point.

.. math:: L(x, \omega) = \frac{1}{N} \sum_j \frac{K(d_j^2 / r^2)}{\pi r^2} f_s(x, \omega_j, \omega) \, \Phi_j

over the photons j within the distance r, of N light paths [Jensen 1996].
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import Array, logger
from etendue.density import KERNELS, HashGrid
from etendue.film import REFLECTED, Component, by_component
from etendue.scene import Media, Problem
from etendue.transport import (
    Edge,
    Gather,
    LightVertices,
    LightWalk,
    Mis,
    Photons,
    Techniques,
    WalkRecorder,
    WalkVertex,
    weigh,
)

from .. import base
from ..base import PILOT_PATHS, ImageMethod, Lanes, total
from ..numbers import path_numbers
from ..store import VertexRoom

#: Density per solid angle from which on a BSDF has a peak, in which a camera path goes on instead of gathering photons.
PEAK = 4.0
#: Device memory of a photon in bytes: its record, the sorted copy, and the search structure.
_BYTES_PER_PHOTON = 48 + 48 + 32


def photon_room(problem: Problem) -> VertexRoom:
    """Capacity of the photon store of a pass."""
    return VertexRoom(_BYTES_PER_PHOTON, LightVertices.floats_per_vertex(False), problem.memory)


@dataclass
class PhotonShot:
    """The photons of a pass."""

    vertices: LightVertices
    paths: int  #: N
    rays: float
    capacity: int


class PhotonTracer:
    """Traces the light paths of a prepared method. A pilot measures the number of photons of a light path."""

    def __init__(self, method: ImageMethod, seed: int) -> None:
        self._method = method
        #: Photons of a light path in the pilot; does not change, even in a resumed run.
        self.photons_per_path = float(self.pilot(seed).wanted[0]) / PILOT_PATHS
        self.room = photon_room(method.problem)
        self.room.per_path = self.photons_per_path

    def pilot(self, seed: int) -> LightVertices:
        """The photons of ``PILOT_PATHS`` light paths with their own numbers."""
        return self._trace("pilot ", 0, seed, PILOT_PATHS, 64 * PILOT_PATHS).vertices

    def fitting(self, wanted: int) -> int:
        """``wanted`` light paths, or fewer if their photons do not fit into memory or the paths into one kernel."""
        paths = min(wanted, max(1, int(self.room.most / max(self.photons_per_path, 1e-6))), base.MOST_LIGHT_LANES)
        if paths < wanted:
            why = "the most of a pass" if paths == base.MOST_LIGHT_LANES else "limited by the memory for photons"
            logger.info("%d instead of %d light paths a pass: %s", paths, wanted, why)
        return paths

    def shoot(self, iteration: int, seed: int, paths: int) -> PhotonShot:
        """Trace the photons of a pass; repeated with a larger store if the capacity was too small."""
        while True:
            shot = self._trace("", iteration, seed, paths, self.room.capacity(paths))
            if self.room.held(float(shot.vertices.wanted[0]), paths):
                return shot

    def _trace(self, role: str, iteration: int, seed: int, paths: int, capacity: int) -> PhotonShot:
        """Trace light paths and store their vertices."""
        owned = self._method.recording.light is not None
        seen = self._method.visibility
        vertices = LightVertices(
            capacity,
            paths,
            indexed=False,
            connected=False,
            owned=owned,
            volumes=seen.volumes,
            disperses=seen.disperses,
        )
        source = self._method.light_numbers(Lanes(0, paths), paths, seed, iteration, role + "light")
        rays, _ = self._walk().trace(paths, source, vertices)
        dr.schedule(rays)
        vertices.launch()
        return PhotonShot(vertices, paths, total(rays), capacity)

    def trace_again(self, number: mi.UInt32, iteration: int, seed: int, paths: int) -> None:
        """Trace the light paths with these numbers, of the ``paths`` of a pass."""
        o = self._method.settings
        source = path_numbers(o.sampler, number, paths, seed, iteration, "light", o.scrambling)
        dr.eval(self._walk().trace(dr.width(number), source))

    def _walk(self) -> LightWalk:
        method = self._method
        mis = Mis(Techniques(emission=0, next_event=0, connection=0, splat=False), [0.0], mi.Float(1.0))
        return method.walker(LightWalk, camera=method.camera, mis=mis, dark=mi.Float(0.0))


@dataclass(frozen=True)
class Peaks:
    """Which light photons do not estimate, because their directions hardly ever fall into the peak of a BSDF: camera
    paths go on in it.

    ``keep_caustics``: photons that came through mirrors and glass only are always gathered, for lights that camera
    paths cannot hit.
    """

    keep_caustics: bool

    def gathers(self, pdf: mi.Float, component: mi.UInt32) -> mi.Bool:
        """Whether photons are gathered from a direction with the density ``pdf`` of the BSDF; ``component``: their
        ``film.Component``."""
        gathered = pdf <= PEAK
        return gathered | (component != int(Component.INDIRECT)) if self.keep_caustics else gathered


def reflected_by(
    photons: Photons,
    photon: mi.UInt32,
    vertex: WalkVertex,
    limit: mi.Float,
    kernel: str,
    active: mi.Bool,
    peaks: Peaks | None = None,
    in_media: bool = False,
) -> mi.Spectrum:
    """Contribution of one photon to the reflected radiance, times ``N pi r^2``; ``limit``: r^2; ``peaks``: leaves out
    what camera paths find; None: all light. ``in_media``: photons are in media, and their contribution is
    times ``N 4/3 pi r^3``."""
    p = photons.read(photon, active)
    distance_squared, weight = weigh(vertex, photons.position(photon, active)[0], p, in_media)
    if kernel != "uniform":
        weight *= KERNELS[kernel].on_disc(dr.minimum(distance_squared / limit, 1.0))
    si = vertex.si
    arguments = mi.BSDFContext(), si, si.to_local(p.direction)
    if peaks is None:
        f = vertex.bsdf.call(mi.BSDF.eval, *arguments, active=active)
    else:
        f, pdf = vertex.bsdf.call(mi.BSDF.eval_pdf, *arguments, active=active)
        f = dr.select(peaks.gathers(pdf, photons.component(photon, active)), f, 0.0)
    value = p.fluence * f
    return dr.select(distance_squared <= limit, value * weight, 0.0)


def no_light(by_kind: bool) -> list[mi.Spectrum]:
    """Zero sums for :func:`add_by_kind`: one of all light, or with ``by_kind`` one for each of ``film.REFLECTED``."""
    return [mi.Spectrum(0.0) for _ in (REFLECTED if by_kind else "1")]


def add_by_kind(
    sums: list[mi.Spectrum], value: mi.Spectrum, photons: Photons, photon: mi.UInt32, active: mi.Bool
) -> list[mi.Spectrum]:
    """The sums with the light of a photon added."""
    if len(sums) == 1:
        return [sums[0] + value]
    values = by_component(value, photons.component(photon, active))
    return [part + value for part, value in zip(sums, values, strict=True)]


def record_merge(
    recorder: WalkRecorder | None,
    vertex: WalkVertex,
    photons: Photons,
    photon: mi.UInt32,
    value: mi.Spectrum,
    active: mi.Bool,
) -> None:
    """Record that a photon contributes ``value`` at a vertex, if rays are recorded."""
    if recorder is not None:
        position, owner = photons.position(photon, active)[0], photons.path(photon, active)
        recorder.joined(Edge.MERGE, vertex, position, value, active, owner)


class PhotonGrid:
    """Photons of a pass in a grid, for density estimation with radii up to ``radius``.

    Parameters
    ----------
    shot: the photons.
    positions, held: position of each slot, and mask of the slots in the grid.
    radius: largest radius, in units of the render space.
    box: lower and upper corner of the scene.
    kernel: name of the kernel.
    by_kind: keep light of different components apart.
    peaks: see :func:`reflected_by`.
    recorder: records which photons contribute to which vertices.
    media: those of the scene, for photons in media, in balls and without a kernel.
    """

    def __init__(
        self,
        shot: PhotonShot,
        positions: mi.Point3f,
        held: mi.Bool,
        radius: float,
        box: tuple[Array, Array],
        kernel: str = "uniform",
        by_kind: bool = False,
        peaks: Peaks | None = None,
        recorder: WalkRecorder | None = None,
        media: Media | None = None,
    ) -> None:
        kernel = kernel if media is None else "uniform"
        grid = HashGrid(positions, radius, *box, held)
        photons = shot.vertices.sorted_by(grid.destination, held, media)
        self._gather = Gather(grid, photons, (), (), media is not None)
        self._paths = dr.opaque(mi.Float, shot.paths)
        self._kernel, self._by_kind, self._peaks, self._recorder = kernel, by_kind, peaks, recorder

    def reflected(
        self, vertex: WalkVertex, edges: mi.UInt32, limit: mi.Float, active: mi.Bool
    ) -> tuple[list[mi.Spectrum], mi.UInt32]:
        """(reflected radiance at a vertex, or with ``by_kind`` that of each of ``film.REFLECTED``; number of photons
        that contribute to it), from the photons with a depth of at most ``edges`` within a squared radius ``limit``."""
        photons, in_media = self._gather.photons, self._gather.in_media

        def visit(photon: mi.UInt32, state: tuple[list[mi.Spectrum], mi.UInt32]) -> tuple[list[mi.Spectrum], mi.UInt32]:
            flux, found = state
            value = reflected_by(photons, photon, vertex, limit, self._kernel, active, self._peaks, in_media)
            record_merge(self._recorder, vertex, photons, photon, value, active)
            found = found + dr.select(dr.all(value == 0.0), mi.UInt32(0), mi.UInt32(1))
            return add_by_kind(flux, value, photons, photon, active), found

        start = no_light(self._by_kind), mi.UInt32(0)
        flux, found = self._gather.around(vertex.position, edges, visit, start, active, limit)
        size = dr.pi * limit * (4.0 / 3.0 * dr.sqrt(limit) if in_media else 1.0)
        return [part / (size * self._paths) for part in flux], found
