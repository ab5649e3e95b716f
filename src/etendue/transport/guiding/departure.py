r"""Learned directions of departure from lights: a density over the sphere for each light.

It is sampled with the light's share a, and the directions of its kind otherwise:

.. math:: p(\omega) = a\, p_{learned}(\omega) + (1 - a)\, p_{kind}(\omega)

in world space, so that a density does not depend on the frame of a surface. A learned direction that is below the
horizon of the light's point is lost. From a sphere of even radiance, on which many would be, the point is sampled after
the direction: rays leave it evenly in all directions, and given the direction, the angle to the normal has the density
that it has given the point. The density of point and direction is then that of the kind, times

.. math:: a\, 4 \pi\, p_{learned}(\omega) + 1 - a.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device
from etendue.density import Quadtrees, QuadtreeSampler

from .guide import direction_of, square_of

#: Solid-angle density of a direction over the density of its point in the square.
_PER_STERADIAN = 0.25 / np.pi


class Departures:
    """The densities on the device.

    Parameters
    ----------
    trees: one density a light, on the square of :func:`~.guide.square_of`.
    share: (lights,) probabilities a.
    is_round: (lights,) whether lights are spheres of even radiance.
    """

    def __init__(self, trees: Quadtrees, share: Array, is_round: NDArray[np.bool_]) -> None:
        self.sampler = QuadtreeSampler(trees)
        self._table = copied_to_device(mi.Float, np.stack([share, is_round], axis=1).astype(np.float32))

    def at(self, row: mi.UInt32, active: mi.Bool) -> Departure:
        """Those of the lights with these numbers, without a sample."""
        share, is_round = dr.gather(mi.Vector2f, self._table, row, active)
        return Departure(self, row, share, is_round > 0.0, mi.Vector3f(0.0, 0.0, 1.0), mi.Bool(False))

    def sample(self, row: mi.UInt32, u: mi.Point2f, choice: mi.Float, active: mi.Bool) -> Departure:
        """A direction of each light, by the numbers ``u``; whether it is used, by the number ``choice``."""
        departure = self.at(row, active)
        departure.applies = active & (choice < departure.share)
        departure.direction = direction_of(self.sampler.sample(row, u, departure.applies)[0])
        return departure


@dataclass
class Departure:
    """The learned directions of one light, one lane each."""

    departures: Departures
    row: mi.UInt32  #: of the light
    share: mi.Float  #: a
    is_round: mi.Bool
    direction: mi.Vector3f  #: world
    applies: mi.Bool  #: whether the ray leaves in ``direction``, and not in one of the light's kind

    def learned(self, direction: mi.Vector3f, own: mi.Float, mask: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
        """(density of a world ``direction`` if the share were 1, its leaf), where the light's kind has the density
        ``own``."""
        density, place = self.departures.sampler.find(self.row, square_of(direction), mask)
        return density * dr.select(self.is_round, own, _PER_STERADIAN), place

    def mixed(self, direction: mi.Vector3f, own: mi.Float, mask: mi.Bool) -> mi.Float:
        """Density of the mixture in a world ``direction``; ``own`` where the mask does not hold."""
        mask = mask & (self.share > 0.0)
        learned, _ = self.learned(direction, own, mask)
        return dr.select(mask, self.share * learned + (1.0 - self.share) * own, own)
