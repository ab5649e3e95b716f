r"""Learned directions of departure from lights: a density over the sphere for each light.

It is sampled with the light's share a, and the directions of its kind otherwise:

.. math:: p(\omega) = a\, p_{learned}(\omega) + (1 - a)\, p_{kind}(\omega)

in world space, so that a density does not depend on the frame of a surface, and one of a curved light tells where its
light is wanted. Directions below the horizon of a point have no light; they are not rejected in the density.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import Array, copied_to_device
from etendue.density import Quadtrees, QuadtreeSampler

from .guide import direction_of, square_of

#: Solid-angle density of a direction over the density of its point in the square.
PER_STERADIAN = 0.25 * float(dr.inv_pi)


class Departures:
    """The densities on the device.

    Parameters
    ----------
    trees: one density a light, on the square of :func:`~.guide.square_of`.
    share: (lights,) probabilities a.
    """

    def __init__(self, trees: Quadtrees, share: Array) -> None:
        self.sampler = QuadtreeSampler(trees)
        self._share = copied_to_device(mi.Float, share.astype("float32"))

    def share(self, row: mi.UInt32, active: mi.Bool) -> mi.Float:
        """a of the lights with these numbers."""
        return dr.gather(mi.Float, self._share, row, active)

    def at(self, row: mi.UInt32) -> Departure:
        """Those of lights, without a sample."""
        return Departure(self, row, mi.Vector3f(0.0, 0.0, 1.0), mi.Bool(False))

    def sample(self, row: mi.UInt32, u: mi.Point2f, choice: mi.Float, active: mi.Bool) -> Departure:
        """A direction of each light, by the numbers ``u``; whether it is used, by the number ``choice``."""
        applies = active & (choice < self.share(row, active))
        point, _, _ = self.sampler.sample(row, u, applies)
        return Departure(self, row, direction_of(point), applies)

    def place(self, row: mi.UInt32, direction: mi.Vector3f, active: mi.Bool) -> mi.UInt32:
        """The leaf that holds a direction of a light."""
        return self.sampler.find(row, square_of(direction), active)[1]


@dataclass
class Departure:
    """The learned directions of one light, one lane each."""

    departures: Departures
    row: mi.UInt32  #: of the light
    direction: mi.Vector3f  #: world
    applies: mi.Bool  #: whether the ray leaves in ``direction``, and not in one of the light's kind

    def mixed(self, direction: mi.Vector3f, own: mi.Float, mask: mi.Bool) -> mi.Float:
        """Density of the mixture in a world ``direction``, of which the light's kind has the density ``own``; ``own``
        where the mask does not hold."""
        share = self.departures.share(self.row, mask)
        learned, _ = self.departures.sampler.find(self.row, square_of(direction), mask & (share > 0.0))
        return dr.select(mask, share * (learned * PER_STERADIAN) + (1.0 - share) * own, own)
