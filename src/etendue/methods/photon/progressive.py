r"""Progressive and stochastic progressive photon mapping.

Each point of ``ppm``, each pixel of ``sppm``, has statistics of its own: R, the radius that is gathered in, and N, the
photons that were counted. A pass that finds M photons changes them to [Hachisuka 2008, eq. 6 to 11]

.. math:: N' = N + \alpha M, \qquad R'^2 = R^2 \frac{N + \alpha M}{N + M}

and the flux :math:`\tau` that was found so far by the same factor as :math:`R^2`, so that :math:`\tau / R^2` is a sum
over passes: a pass adds :math:`\tau_M / (\pi R^2 N_e)` to the picture, and R and N are all that is carried on.

``sppm`` looks at new points in each pass, all those of a pixel with one R and one N [Hachisuka 2009], so depth of
field, glossy reflection and antialiasing converge too. ``ppm`` looks at the same points in each pass; they are found
again by the same random numbers rather than stored, a ray each instead of some 200 bytes each.

Where no photon is ever found, R would stay as it began, and the grid of photons as coarse as that. So R is never above
a radius that shrinks whatever is found, by :math:`R^2_{i+1} = R^2_i (i + \alpha) / (i + 1)` after pass i, which is
slower than R does where photons are found in every pass [KnausZwicker 2011].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Carrying, CheckpointError, State, copied_to_device, setting
from etendue.density import KdTree
from etendue.scene import Problem
from etendue.transport import Kind, WalkVertex

from .. import radius as radii
from ..base import ImageSettings, corners
from .mapping import GatherPath, PhotonMapping, PhotonSettings
from .photons import PhotonGrid, PhotonShot

#: Smallest first radius over the largest, squared.
_LEAST_SHARE = 1e-6
#: Points that ``ppm`` looks at in a pixel, at least: what they miss of an edge is missed for ever.
_LEAST_POINTS = 4


@dataclass(frozen=True)
class SppmSettings(PhotonSettings):
    """Settings of ``ppm`` and ``sppm``."""

    light_paths: float = setting(1.0, "light paths traced per camera path", above=0.0, maximum=64.0)
    radius: float = setting(0.006, "first gather radius, in the unit of radius_unit", above=0.0)
    radius_unit: str = setting("scene", radii.UNIT_DOC, choices=radii.UNITS)
    neighbours: int = setting(
        0,
        "photons of the first pass that a path's first radius shall hold, where radius is as wide; 0: it is radius",
        minimum=0,
        maximum=1000,
    )
    alpha: float = setting(2.0 / 3.0, "share of the photons found that is kept in N", above=0.0, maximum=1.0)


class Sppm(Carrying, PhotonMapping):
    """Stochastic progressive photon mapping: new points in each pass, a radius for each pixel."""

    name: ClassVar[str] = "sppm"
    Settings: ClassVar[type[ImageSettings]] = SppmSettings
    citations: ClassVar[tuple[str, ...]] = ("Hachisuka2009", "Hachisuka2008", "Jensen1996")
    carries_on: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """The first radii: the same for every path, or found by the nearest photons."""
        self._forget_states()
        super().prepare(problem, seed)
        first = radii.absolute_radius(self, self.settings.radius, self.settings.radius_unit, seed)
        #: Camera paths of a pass that share R and N: those of a point, or of a pixel.
        self._sharing = 1 if self.fixed_points else self.samples_per_iteration
        entries = self.camera.pixels * self.samples_per_iteration // self._sharing
        self._radius_squared = dr.full(mi.Float, first * first, entries)
        self._count = dr.zeros(mi.Float, entries)
        self._most = first * first  # of R^2
        self._passes = 0
        self._box = corners(problem)
        self._tree: KdTree | None = None
        if self.settings.neighbours:
            self._begin_with_nearest(first * first, seed)

    def _begin_with_nearest(self, limit: float, seed: int) -> None:
        """First radii that hold as many photons as asked for, of those of the first pass, around the points that it
        will look at; ``limit``: the largest, squared."""
        positions, held = self._wanted(self.shoot(0, seed))
        self._tree, self._limit = KdTree(positions, held), dr.opaque(mi.Float, limit)
        path = self._trace("", 0, seed, self.samples_per_iteration)
        squared = dr.reinterpret_array(mi.Float, path.found)
        # Photons may lie on one spot: a radius of zero would never find another.
        squared = dr.select(path.first, self._limit, dr.maximum(squared, _LEAST_SHARE * self._limit))
        self._radius_squared, self._tree = dr.block_sum(squared, self._sharing) / self._sharing, None
        dr.eval(self._radius_squared)

    def _wanted(self, shot: PhotonShot) -> tuple[mi.Point3f, mi.Bool]:
        """(positions, which of them are gathered), one lane a slot."""
        positions, kind, held = shot.vertices.positions()
        if self.settings.direct == "next_event":
            held &= kind != mi.UInt32(Kind.DIRECT)
        return positions, held

    def light_paths(self) -> int:
        """See :class:`PhotonMapping`."""
        return max(1, round(self.settings.light_paths * self.camera.pixels * self.samples_per_iteration))

    def build(self, shot: PhotonShot, iteration: int, seed: int) -> None:
        """Sort the photons into a grid for the largest radius there is."""
        positions, held = self._wanted(shot)
        largest = float(np.sqrt(np.asarray(self._radius_squared).max()))
        self._photons = PhotonGrid(shot, positions, held, largest, self._box, self.settings.kernel)

    def gather(self, s: GatherPath, vertex: WalkVertex, active: mi.Bool) -> tuple[mi.Color3f, mi.UInt32]:
        """See :class:`PhotonMapping`."""
        if self._tree is not None:  # only the distance is asked for; it goes where the number of photons goes
            squared = self._tree.kth_distance_squared(vertex.position, self.settings.neighbours, self._limit, active)
            return mi.Color3f(0.0), dr.reinterpret_array(mi.UInt32, squared)
        limit = dr.gather(mi.Float, self._radius_squared, s.lane // self._sharing, active)
        return self._photons.reflected(vertex, self.edges - s.depth, limit, active)

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
        """R^2 and N of every point or pixel, and what bounds R^2."""
        return {
            "radius_squared": self._radius_squared,
            "count": self._count,
            "most": self._most,
            "passes": self._passes,
        }

    def _take(self, state: State) -> None:
        radius_squared, count = np.asarray(state["radius_squared"]), np.asarray(state["count"])
        if radius_squared.shape != (len(self._count),) or count.shape != radius_squared.shape:
            raise CheckpointError("the checkpoint's photon statistics are of another size; start anew")
        self._radius_squared, self._count = (copied_to_device(mi.Float, a) for a in (radius_squared, count))
        self._most, self._passes = float(state["most"]), int(state["passes"])


class Ppm(Sppm):
    """Progressive photon mapping: the same points in each pass."""

    name: ClassVar[str] = "ppm"
    citations: ClassVar[tuple[str, ...]] = ("Hachisuka2008", "Jensen1996")
    fixed_points = True

    def _samples(self, problem: Problem) -> int:
        return int(self.settings.samples_per_pass) or max(_LEAST_POINTS, super()._samples(problem))
