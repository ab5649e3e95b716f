"""The stored light vertices as a cache, from which the connections of camera vertices draw."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource

from .. import dimensions as dim
from ..guiding.connections import ConnectionGuide
from ..visibility import Visibility
from .vertices import LightVertex, LightVertices

#: Lanes that share a random number for picking light vertices, a power of two.
PICK_BLOCK = 16
#: Shift of a lane's bit-reversed number that leaves the bit-reversed number in the block.
_STRATUM_SHIFT = 33 - PICK_BLOCK.bit_length()


@dataclass
class Pick:
    """How a light vertex was chosen by classes."""

    camera: mi.UInt32  #: class of the camera vertex
    drawn: mi.Bool  #: whether there was a vertex to choose
    chance: mi.Float  #: probability of the vertex over that of a uniform choice
    ratio: mi.Float  #: ``chance`` as expected before the pass, for the weights


@dataclass
class LightCache:
    """The stored light vertices for connections.

    With ``picks``, ``techniques.connection`` vertices are sampled from all paths [Davidovic 2014], uniformly, or by
    the classes of ``choice``. The lanes of a block share their random numbers and take consecutive vertices, which are
    close in memory; each lane's vertex is uniformly distributed over all vertices or over its class. Without ``picks``,
    a camera path is connected to all vertices of the light path with the same number.
    """

    vertices: LightVertices
    count: mi.UInt32  #: M, on the device
    factor: mi.Float  #: M / (N k), or 1 without ``picks``; on the device
    paths: mi.UInt32  #: N, opaque
    picks: SampleSource | None  #: numbers of the blocks of ``PICK_BLOCK`` lanes
    choice: ConnectionGuide | None = None
    first: mi.UInt32 | None = None  #: first number of each class, and the end, with ``choice``

    def draw(
        self,
        lane: mi.UInt32,
        depth: mi.UInt32,
        index: int,
        place: mi.UInt32 | None,
        active: mi.Bool,
        visibility: Visibility,
    ) -> tuple[LightVertex, mi.Bool, Pick | None]:
        """Draw the light vertex of connection ``index`` of camera vertices at ``depth``, of the class ``place``;
        ``visibility``: that of the scene. (vertex, whether there is one, how it was chosen by classes)."""
        assert self.picks is not None
        begin, size = mi.UInt32(0), self.count
        if self.choice is not None and place is not None:
            # Stratified over the block, whose lanes are samples of a few pixels.
            u = self.picks.next_1d(depth, index) + mi.Float(dr.brev(lane) >> _STRATUM_SHIFT) / PICK_BLOCK
            every, chosen = self.choice.draw(place, u - dr.floor(u), active)
            by_class = active & ~every
            begin = dr.select(every, 0, self._bound(chosen, by_class))
            size = dr.select(every, self.count, self._bound(chosen + 1, by_class) - begin)
        active = active & (size > 0)
        offset = dr.select(size >= PICK_BLOCK, lane % PICK_BLOCK, 0)
        number = mi.UInt32(self.picks.next_1d(depth, dim.CONNECT + index) * mi.Float(size)) + offset
        number = begin + dr.select(number < size, number, number - size)
        light = self.vertices.read(self.vertices.slot(number, active), active, visibility)
        if self.choice is None or place is None:
            return light, active, None
        share, ratio = self.choice.pair(place, light.place, active)
        held = self._bound(light.place + 1, active) - self._bound(light.place, active)
        return light, active, Pick(place, active, self.choice.ratio(share, held, self.count), ratio)

    def _bound(self, number: mi.UInt32, active: mi.Bool | bool = True) -> mi.UInt32:
        """First number of a class."""
        return dr.gather(mi.UInt32, self.first, number, active)

    def population(self) -> mi.UInt32:
        """Number of vertices of each class."""
        number = dr.arange(mi.UInt32, dr.width(self.first) - 1)
        return self._bound(number + 1) - self._bound(number)
