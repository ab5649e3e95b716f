r"""Progressive and stochastic progressive photon mapping.

Each gather point of ``ppm``, each pixel of ``sppm``, has its own radius R and photon count N. A pass that finds M
photons changes them to [Hachisuka 2008, eq. 6 to 11]

.. math:: N' = N + \alpha M, \qquad R'^2 = R^2 \frac{N + \alpha M}{N + M}

and scales the flux :math:`\tau` found so far by the same factor as :math:`R^2`. Therefore :math:`\tau / R^2` is a sum
over passes: a pass adds :math:`\tau_M / (\pi R^2 N_e)` to the picture, and the state is R and N only.

``sppm`` has new gather points in each pass; those of a pixel share R and N [Hachisuka 2009], so that depth of field,
glossy reflection and antialiasing converge, too. ``ppm`` has the same gather points in each pass. They are not stored
but traced again with the same random numbers.

Where no photons are found, R would not shrink, and the cells of the photon grid would stay large. R is therefore
limited by a radius that shrinks in any case, by :math:`R^2_{i+1} = R^2_i (i + \alpha) / (i + 1)` after pass i; where
every pass finds photons, R shrinks faster than this [KnausZwicker 2011].

In participating media photons are gathered in a ball, whose volume shrinks as the limit of the area does: by
:math:`r^3_{i+1} = r^3_i (i + \alpha) / (i + 1)` [KnausZwicker 2011].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Carrying, CheckpointError, State, copied_to_device, setting
from etendue.density import KdTree
from etendue.scene import Problem, corners_of
from etendue.transport import Kind, WalkVertex

from .. import radius as radii
from ..base import PILOT_PATHS, ImageSettings
from .mapping import GatherPath, PhotonMapping, PhotonSettings
from .photons import PhotonGrid, PhotonShot, no_light

#: Least first radius over the largest, squared.
_LEAST_SHARE = 1e-6
#: Least number of gather points of ``ppm`` in a pixel: further passes do not decrease the error at an edge.
_LEAST_POINTS = 4


@dataclass(frozen=True)
class SppmSettings(PhotonSettings):
    """Settings of ``ppm`` and ``sppm``."""

    light_paths: float = setting(
        1.0, "light paths per camera path; more: less noise, more time per pass", above=0.0, maximum=64.0
    )
    radius: float = setting(
        0.0,
        f"radius of density estimation in the first pass, in the unit of radius_unit; {radii.RADIUS_DOC}",
        minimum=0.0,
    )
    radius_unit: str = setting("scene", radii.UNIT_DOC, choices=radii.UNITS)
    volume_radius: float = setting(
        0.0, f"radius of density estimation in media in the first pass, as radius; {radii.BALL_DOC}", minimum=0.0
    )
    neighbours: int = setting(
        0,
        "k: the first radius of a point is the distance of the k-th nearest photon of the first pass, at most radius; "
        "0: the first radius is radius everywhere",
        minimum=0,
        maximum=1000,
    )
    alpha: float = setting(
        2.0 / 3.0,
        "share of the new photons that is added to the photon count; smaller: the radius shrinks faster, with more "
        "noise and less blur",
        above=0.0,
        maximum=1.0,
    )


class Sppm(Carrying, PhotonMapping):
    """Stochastic progressive photon mapping: new gather points in each pass, a radius for each pixel."""

    name: ClassVar[str] = "sppm"
    Settings: ClassVar[type[ImageSettings]] = SppmSettings
    settings: SppmSettings
    citations: ClassVar[tuple[str, ...]] = ("Hachisuka2009", "Hachisuka2008", "Jensen1996", "JensenChristensen1998")
    carries_on: ClassVar[bool] = True
    media: ClassVar[str | None] = "scattering"
    spectral: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`PhotonMapping`. The first radii are equal, or found from the nearest photons."""
        self._forget_states()
        super().prepare(problem, seed)
        o = self.settings
        self._discs = radii.first_radius(self, o.radius, o.radius_unit)
        self._balls = radii.Balls()
        if self.visibility.volumes:
            pilot = radii.Pilot(self.tracer.pilot(seed), PILOT_PATHS, o.light_paths)
            self._balls = radii.first_balls(self, self._discs, o.volume_radius, o.radius_unit, pilot)
        first = self._discs.largest
        #: Camera paths of a pass that share R and N: those of a point, or of a pixel.
        self._sharing = 1 if self.fixed_points else self.samples_per_iteration
        entries = self.camera.pixels * self.samples_per_iteration // self._sharing
        #: R^2 where the first radius is largest; elsewhere it has a share of that.
        self._radius_squared = dr.full(mi.Float, first * first, entries)
        self._count = dr.zeros(mi.Float, entries)
        self._most = first * first  # upper limit of R^2
        self._passes = 0
        self._box = corners_of(problem.scene)
        self._tree: KdTree | None = None
        if self.settings.neighbours:
            self._begin_with_nearest(first * first, seed)

    def _begin_with_nearest(self, limit: float, seed: int) -> None:
        """Set the first radii to the distance of the k-th photon of the first pass, around its gather points;
        ``limit``: the largest, squared."""
        positions, held = self._wanted(self.shoot(0, seed))
        self._tree, self._limit = KdTree(positions, held), dr.opaque(mi.Float, limit)
        path = self._trace("", 0, seed, self._lanes(), self.samples_per_iteration)
        squared = dr.reinterpret_array(mi.Float, path.found)
        # Photons may have the same position: a radius of 0 would never find any.
        squared = dr.select(path.first, self._limit, dr.maximum(squared, _LEAST_SHARE * self._limit))
        self._radius_squared, self._tree = dr.block_sum(squared, self._sharing) / self._sharing, None
        dr.eval(self._radius_squared)

    def _wanted(self, shot: PhotonShot, in_media: bool = False) -> tuple[mi.Point3f, mi.Bool]:
        """(positions, mask of the photons that are gathered on surfaces, or ``in_media``), one lane a slot."""
        positions, kind, held = shot.vertices.positions(in_media)
        if self.settings.direct == "next_event":
            held &= kind != mi.UInt32(Kind.DIRECT)
        return positions, held

    def light_paths(self) -> int:
        """See :class:`PhotonMapping`."""
        return max(1, round(self.settings.light_paths * self.camera.pixels * self.samples_per_iteration))

    def build(self, shot: PhotonShot, iteration: int, seed: int) -> None:
        """Sort the photons into a grid for the largest radius."""
        positions, held = self._wanted(shot)
        largest = float(np.sqrt(np.asarray(self._radius_squared).max()))
        o = self.settings
        own = o.kernel, o.components, self.peaks, self.recording.camera
        self._photons = PhotonGrid(shot, positions, held, largest, self._box, *own)
        if self.visibility.volumes:
            positions, held = self._wanted(shot, in_media=True)
            # Its upper limit, not R itself, which is measured by the photons of surfaces.
            ball = self._balls.radius(math.sqrt(self._most))
            self._ball = dr.opaque(mi.Float, ball**2)
            self._in_media = PhotonGrid(shot, positions, held, ball, self._box, *own, self.visibility.media)

    def gather(self, s: GatherPath, vertex: WalkVertex, active: mi.Bool) -> tuple[list[mi.Spectrum], mi.UInt32]:
        """See :class:`PhotonMapping`."""
        share, in_medium = self._discs.share(vertex.position), vertex.bsdf.in_medium
        if in_medium is not None:
            inside, active = active & in_medium, active & ~in_medium
        if self._tree is not None:  # called by _begin_with_nearest, which reads the distance from the photon count
            limit = self._limit * share
            squared = self._tree.kth_distance_squared(vertex.position, self.settings.neighbours, limit, active)
            return no_light(self.settings.components), dr.reinterpret_array(mi.UInt32, squared / share)
        limit = dr.gather(mi.Float, self._radius_squared, s.point // self._sharing, active) * share
        reflected, found = self._photons.reflected(vertex, self.edges - s.depth, limit, active)
        if in_medium is not None:
            scattered, _ = self._in_media.reflected(vertex, self.edges - s.depth, self._ball, inside)
            reflected = [dr.select(in_medium, a, b) for a, b in zip(scattered, reflected, strict=True)]
        return reflected, found

    def finish(self, found: mi.UInt32) -> None:
        """Shrink the radii [Hachisuka 2008, eq. 6, 8; KnausZwicker 2011]."""
        alpha = self.settings.alpha
        found = mi.Float(dr.block_sum(found, self._sharing))
        count = self._count + alpha * found
        all_found = self._count + found
        passes = self._passes + 1
        most = self._most * (passes + alpha) / (passes + 1)
        squared = self._radius_squared * dr.select(all_found > 0.0, count / all_found, 1.0)
        squared = dr.minimum(squared, dr.opaque(mi.Float, most))
        dr.eval(squared, count)
        self._radius_squared, self._count, self._most, self._passes = squared, count, most, passes

    def _left(self) -> State:
        """R^2 and N of every gather point or pixel, and the upper limit of R^2."""
        return {
            "radius_squared": self._radius_squared,
            "count": self._count,
            "most": self._most,
            "passes": self._passes,
        }

    def _take(self, state: State) -> None:
        radius_squared, count = np.asarray(state["radius_squared"]), np.asarray(state["count"])
        if radius_squared.shape != (len(self._count),) or count.shape != radius_squared.shape:
            raise CheckpointError("the photon statistics in the checkpoint do not fit this picture; start a new run")
        self._radius_squared, self._count = (copied_to_device(mi.Float, a) for a in (radius_squared, count))
        self._most, self._passes = float(state["most"]), int(state["passes"])


class Ppm(Sppm):
    """Progressive photon mapping: the same gather points in each pass."""

    name: ClassVar[str] = "ppm"
    citations: ClassVar[tuple[str, ...]] = ("Hachisuka2008", "Jensen1996")
    fixed_points = True

    def samples_for(self, problem: Problem) -> int:
        """See :class:`ImageMethod`."""
        return int(self.settings.samples_per_pass) or max(_LEAST_POINTS, super().samples_for(problem))
