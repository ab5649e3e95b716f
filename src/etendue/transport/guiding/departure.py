r"""Learned directions of departure from lights: a density over the sphere for each light.

A direction is sampled from this density with the light's share a, and otherwise from the density of the light's kind:

.. math:: p(\omega) = a\, p_{learned}(\omega) + (1 - a)\, p_{kind}(\omega)

in world space, so that a density does not depend on the frame of a surface. A learned direction below the horizon of
the light's point is lost. On a sphere of uniform radiance many directions would be lost; there, the point is sampled
after the direction: rays leave the sphere uniformly in all directions, and the angle between direction and normal has
the same density whether the direction or the point is given. The density of point and direction is then that of the
kind, times

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

from .guide import PER_STERADIAN, direction_of, square_of


class Departures:
    """The densities on the device.

    Parameters
    ----------
    trees: one density per light, on the square of :func:`~.guide.square_of`.
    share: (lights,) probabilities a.
    is_round: (lights,) whether lights are spheres of uniform radiance.
    """

    def __init__(self, trees: Quadtrees, share: Array, is_round: NDArray[np.bool_]) -> None:
        self.sampler = QuadtreeSampler(trees)
        self._table = copied_to_device(mi.Float, np.stack([share, is_round], axis=1).astype(np.float32))

    def at(self, row: mi.UInt32, active: mi.Bool) -> Departure:
        """The densities of the lights with numbers ``row``, without a sample."""
        share, is_round = dr.gather(mi.Vector2f, self._table, row, active)
        return Departure(self, row, share, is_round > 0.0, mi.Vector3f(0.0, 0.0, 1.0), mi.Bool(False))

    def sample(self, row: mi.UInt32, u: mi.Point2f, choice: mi.Float, active: mi.Bool) -> Departure:
        """A direction of each light, sampled with the random numbers ``u``; ``choice`` decides whether it is used."""
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
    applies: mi.Bool  #: whether the ray leaves in ``direction``, not in a direction of the light's kind

    def learned(self, direction: mi.Vector3f, own: mi.Float, mask: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
        """(density of a world ``direction`` if the share were 1, its leaf). ``own``: density of the direction by the
        light's kind."""
        density, place = self.departures.sampler.find(self.row, square_of(direction), mask)
        return density * dr.select(self.is_round, own, PER_STERADIAN), place

    def mixed(self, direction: mi.Vector3f, own: mi.Float, mask: mi.Bool) -> mi.Float:
        """Density of the mixture in a world ``direction``; ``own`` where the mask does not hold."""
        mask = mask & (self.share > 0.0)
        learned, _ = self.learned(direction, own, mask)
        return dr.select(mask, self.share * learned + (1.0 - self.share) * own, own)
