"""The technique pyramid: on the device, a picture for each technique, with its weight and without [Veach 1997, 10.3].

Within a kernel the vertices of a path are counted by loops, so the technique of a contribution is a number as any
other: one buffer holds all pictures, and a contribution finds its place in it through a table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, on_device
from etendue.film import LONGER, Technique

from ..camera import SplatPlace
from .mis import Techniques

#: Bytes that a pixel of a layer takes: four floats on the device; on the host a pass's sum, the sum of all passes, the
#: picture, and the channels that are written.
_BYTES = 16 + 24 + 24 + 12 + 12
#: Longest paths that a pyramid may be asked for; light vertices keep their number in four bits.
PYRAMID_MAX = 12


class Pyramid:
    """Sums of contributions by technique and pixel.

    Parameters
    ----------
    techniques: those in use.
    depth: edges of the longest paths that get pictures of their own, at most :data:`PYRAMID_MAX`.
    pixels: of the image.
    """

    def __init__(self, techniques: Techniques, depth: int, pixels: int) -> None:
        self.techniques = in_pyramid(techniques, depth)
        self._depth, self._pixels = depth, pixels
        self._longer = len(self.techniques)
        table = np.full((2, depth + 1, depth + 1), self._longer, np.uint32)
        for slot, technique in enumerate(self.techniques):
            table[int(technique.merged), technique.edges, technique.s] = slot
        self._table = on_device(mi.UInt32, table.ravel())
        #: Weighted layers, that of longer paths, unweighted ones, splats of longer paths; a packet of four floats a
        #: pixel. Splats are filtered as they come, what camera paths bring in the end.
        self.array = dr.zeros(mi.Float, 4 * pixels * (2 * self._longer + 2))

    @staticmethod
    def bytes(techniques: Techniques, depth: int, pixels: int) -> int:
        """Memory that a rendering with such a pyramid takes for it.

        Raises :class:`OptionError` if an array of the device cannot hold it, whatever the memory."""
        layers = 2 * len(in_pyramid(techniques, depth)) + 2
        if 4 * pixels * layers >= 1 << 32:
            raise OptionError(f"a technique pyramid has {layers} layers, too many for {pixels} pixels; lower the size")
        return _BYTES * pixels * layers

    def add(self, merged: bool, s: Any, t: Any, pixel: Any, weighted: Any, alone: Any, active: Any) -> None:
        """Add what a camera path brings to its pixel: ``weighted`` as to the picture, ``alone`` without its weight.
        What is not finite is left out here, and counted where the picture is summed."""
        slot, inside = self._slot(merged, s, t, active)
        self._scatter(dr.select(inside, slot, self._longer), pixel, weighted, active)
        self._scatter(slot + (self._longer + 1), pixel, alone, active & inside)

    def add_splat(self, s: Any, place: SplatPlace, weighted: Any, alone: Any, active: Any) -> None:
        """Add a splat by a light sub-path of ``s`` vertices, as :meth:`add` does."""
        slot, inside = self._slot(False, s, mi.UInt32(1), active)
        first = dr.select(inside, slot, 2 * self._longer + 1)
        for pixel, share, on_film in place.taps:
            self._scatter(first, pixel, weighted * share, active & on_film)
            self._scatter(slot + (self._longer + 1), pixel, alone * share, active & inside & on_film)

    def _slot(self, merged: bool, s: Any, t: Any, active: Any) -> tuple[Any, Any]:
        """(number of a technique, whether it has a picture of its own)."""
        edges = s + t - (2 if merged else 1)
        inside = edges <= self._depth
        row = edges + (self._depth + 1 if merged else 0)
        return dr.gather(mi.UInt32, self._table, row * (self._depth + 1) + s, active & inside), inside

    def _scatter(self, slot: Any, pixel: Any, value: Any, active: Any) -> None:
        packet = mi.Vector4f(value.x, value.y, value.z, 0.0)
        active = active & dr.all(dr.isfinite(value)) & dr.any(value != 0.0)
        dr.scatter_reduce(dr.ReduceOp.Add, self.array, packet, slot * self._pixels + pixel, active)

    def layers(self, image: Callable[[Any], NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        """The pictures by name, (height, width, 3), sums over all paths. ``image`` makes one of what camera paths
        contribution to their pixels, a lane a pixel."""
        lanes = dr.arange(mi.UInt32, self._pixels)
        sums = []
        for slot, technique in enumerate([*self.techniques, None, *self.techniques, None]):
            packet = dr.gather(mi.Vector4f, self.array, lanes + dr.opaque(mi.UInt32, slot * self._pixels))
            colour = mi.Color3f(packet.x, packet.y, packet.z)
            splats = slot == 2 * self._longer + 1 or (technique is not None and technique.t == 1 and technique.s > 0)
            sums.append(np.array(dr.ravel(colour)).reshape(-1, 3) if splats else image(colour))
        shape = sums[self._longer].shape
        sums[self._longer] = sums[self._longer] + sums.pop().reshape(shape)
        names = [technique.layer() for technique in self.techniques] + [LONGER]
        names += [technique.layer(weighted=False) for technique in self.techniques]
        return {name: picture.reshape(shape) for name, picture in zip(names, sums, strict=True)}


def in_pyramid(techniques: Techniques, depth: int) -> list[Technique]:
    """The techniques in use that make paths of at most ``depth`` edges: by length, then by vertices of the light."""
    found = []
    for edges in range(1, depth + 1):
        for s in range(edges + 1):
            t = edges + 1 - s
            if s == 0:
                on = True
            elif t == 1:
                on = techniques.splat and s > 1
            elif s == 1:
                on = techniques.next_event > 0
            else:
                on = techniques.connection > 0
            if on:
                found.append(Technique(False, s, t))
    if techniques.merge:
        first = 2 if techniques.merge_first else 3
        found += [
            Technique(True, edges + 2 - t, t) for edges in range(2, depth + 1) for t in range(edges, first - 1, -1)
        ]
    return found
