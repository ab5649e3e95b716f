"""The technique pyramid: on the device, a picture for each technique, with its weight and without [Veach 1997, 10.3].

Within a kernel the vertices of a path are counted by loops, so the technique of a contribution is a number as any
other: one buffer holds all pictures, and a contribution finds its place in it through a table.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, on_device
from etendue.film import LONGER, Technique

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
        #: Weighted layers, that of longer paths, unweighted ones; a packet of four floats a pixel.
        self.array = dr.zeros(mi.Float, 4 * pixels * (2 * self._longer + 1))

    @staticmethod
    def bytes(techniques: Techniques, depth: int, pixels: int) -> int:
        """Memory that a rendering with such a pyramid takes for it.

        Raises :class:`OptionError` if an array of the device cannot hold it, whatever the memory."""
        layers = 2 * len(in_pyramid(techniques, depth)) + 1
        if 4 * pixels * layers >= 1 << 32:
            raise OptionError(f"a technique pyramid has {layers} layers, too many for {pixels} pixels; lower the size")
        return _BYTES * pixels * layers

    def add(self, merged: bool, s: Any, t: Any, pixel: Any, weighted: Any, alone: Any, active: Any) -> None:
        """Add a path's contribution: ``weighted`` as to the picture, ``alone`` without its weight. What is not finite
        is left out here, and counted where the picture is summed."""
        edges = s + t - (2 if merged else 1)
        inside = edges <= self._depth
        row = edges + (self._depth + 1 if merged else 0)
        slot = dr.gather(mi.UInt32, self._table, row * (self._depth + 1) + s, active & inside)
        slot = dr.select(inside, slot, self._longer)
        self._scatter(slot, pixel, weighted, active)
        self._scatter(slot + (self._longer + 1), pixel, alone, active & inside)

    def _scatter(self, slot: Any, pixel: Any, value: Any, active: Any) -> None:
        packet = mi.Vector4f(value.x, value.y, value.z, 0.0)
        active = active & dr.all(dr.isfinite(value)) & dr.any(value != 0.0)
        dr.scatter_reduce(dr.ReduceOp.Add, self.array, packet, slot * self._pixels + pixel, active)

    def layers(self, height: int, width: int) -> dict[str, NDArray[np.float32]]:
        """The pictures on the host by name, (height, width, 3), sums over all paths."""
        sums = np.asarray(self.array).reshape(-1, height, width, 4)
        names = [technique.layer() for technique in self.techniques] + [LONGER]
        names += [technique.layer(weighted=False) for technique in self.techniques]
        return {name: np.array(picture[..., :3]) for name, picture in zip(names, sums, strict=True)}


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
