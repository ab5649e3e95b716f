"""The technique pyramid: a picture for each technique, with MIS weight and without [Veach 1997, sec. 10.3].

All pictures are in one buffer on the device. A kernel computes the technique of a contribution from the numbers of
vertices of the two sub-paths, and a table maps the technique to its layer of the buffer.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, on_device
from etendue.film import LONGER, Technique
from etendue.scene import Packet

from ..camera import SplatPlace
from ..packing import packed_sum, unpacked_sum
from .techniques import Techniques

#: Bytes per pixel and layer: four floats on the device; on the host the sum of a pass, the sum of all passes, the
#: picture, and the channels that are written.
_BYTES = 16 + 24 + 24 + 12 + 12
#: Edges of the longest paths that a pyramid can show: light vertices store their number in four bits.
PYRAMID_MAX = 12


class Pyramid:
    """Sums of contributions by technique and pixel.

    Parameters
    ----------
    techniques: the techniques in use.
    depth: edges of the longest paths with pictures of their own, at most :data:`PYRAMID_MAX`.
    pixels: pixels of the image.
    packet: wavelengths of the contributions.
    """

    def __init__(self, techniques: Techniques, depth: int, pixels: int, packet: Packet) -> None:
        self._packet = packet
        self.techniques = in_pyramid(techniques, depth)
        self._depth, self._pixels = depth, pixels
        self._longer = len(self.techniques)
        table = np.full((2, depth + 1, depth + 1), self._longer, np.uint32)
        for slot, technique in enumerate(self.techniques):
            table[int(technique.merged), technique.edges, technique.s] = slot
        self._table = on_device(mi.UInt32, table.ravel())
        #: Weighted layers, the layer of longer paths, unweighted layers, splats of longer paths; four floats per pixel.
        #: Splats are filtered when they are added, contributions of camera paths in :meth:`layers`.
        self.array = dr.zeros(mi.Float, 4 * pixels * (2 * self._longer + 2))

    @staticmethod
    def bytes(techniques: Techniques, depth: int, pixels: int) -> int:
        """Memory of such a pyramid in bytes, on device and host.

        Raises :class:`OptionError` if the pyramid has more numbers than a device array can have, 2^32."""
        layers = 2 * len(in_pyramid(techniques, depth)) + 2
        if 4 * pixels * layers >= 1 << 32:
            raise OptionError(f"a technique pyramid has {layers} layers, too many for {pixels} pixels; lower the size")
        return _BYTES * pixels * layers

    def add(
        self,
        merged: bool,
        s: mi.UInt32,
        t: mi.UInt32,
        pixel: mi.UInt32,
        weighted: mi.Spectrum,
        alone: mi.Spectrum,
        active: mi.Bool,
    ) -> None:
        """Add a contribution of camera paths to their pixels: ``weighted`` with the MIS weight, ``alone`` without.
        Values that are not finite are left out; they are counted where the picture is summed."""
        slot, inside = self._slot(merged, s, t, active)
        self._scatter(dr.select(inside, slot, self._longer), pixel, weighted, active)
        self._scatter(slot + (self._longer + 1), pixel, alone, active & inside)

    def add_splat(
        self, s: mi.UInt32, place: SplatPlace, weighted: mi.Spectrum, alone: mi.Spectrum, active: mi.Bool
    ) -> None:
        """Add a splat of light sub-paths of ``s`` vertices, as :meth:`add` does."""
        slot, inside = self._slot(False, s, mi.UInt32(1), active)
        first = dr.select(inside, slot, 2 * self._longer + 1)
        for pixel, share, on_film in place.taps:
            self._scatter(first, pixel, weighted * share, active & on_film)
            self._scatter(slot + (self._longer + 1), pixel, alone * share, active & inside & on_film)

    def _slot(self, merged: bool, s: mi.UInt32, t: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """(layer of a technique, whether it has a layer of its own)."""
        edges = s + t - (2 if merged else 1)
        inside = edges <= self._depth
        row = edges + (self._depth + 1 if merged else 0)
        return dr.gather(mi.UInt32, self._table, row * (self._depth + 1) + s, active & inside), inside

    def _scatter(self, slot: mi.UInt32, pixel: mi.UInt32, value: mi.Spectrum, active: mi.Bool) -> None:
        active = active & dr.all(dr.isfinite(value)) & dr.any(value != 0.0)
        packet = packed_sum(self._packet.recorded(value))
        dr.scatter_reduce(dr.ReduceOp.Add, self.array, packet, slot * self._pixels + pixel, active)

    def layers(self, image: Callable[[mi.Color3f], NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        """The pictures by name, (height, width, channels), sums over all paths. ``image`` filters sums of
        contributions of camera paths, one lane a pixel."""
        lanes = dr.arange(mi.UInt32, self._pixels)
        sums = []
        for slot, technique in enumerate([*self.techniques, None, *self.techniques, None]):
            packet = dr.gather(mi.Vector4f, self.array, lanes + dr.opaque(mi.UInt32, slot * self._pixels))
            colour = unpacked_sum(packet, self._packet)
            splats = slot == 2 * self._longer + 1 or (technique is not None and technique.t == 1 and technique.s > 0)
            sums.append(np.array(dr.ravel(colour)).reshape(-1, len(colour)) if splats else image(colour))
        shape = sums[self._longer].shape
        sums[self._longer] = sums[self._longer] + sums.pop().reshape(shape)
        names = [technique.layer() for technique in self.techniques] + [LONGER]
        names += [technique.layer(weighted=False) for technique in self.techniques]
        return {name: picture.reshape(shape) for name, picture in zip(names, sums, strict=True)}


def in_pyramid(techniques: Techniques, depth: int) -> list[Technique]:
    """The techniques in use for paths of at most ``depth`` edges, ordered by edges and vertices of the light
    sub-path."""
    found = []
    for edges in range(1, depth + 1):
        for s in range(edges + 1):
            t = edges + 1 - s
            if s == 0:
                on = True
            elif t == 1:
                on = techniques.splat and s > (2 if techniques.leaves_direct else 1)
            elif s == 1:
                on = techniques.next_event > 0
            else:
                on = techniques.connection > 0
            if on:
                found.append(Technique(False, s, t))
    if techniques.merge:
        first = 2 if techniques.merge_first else 3
        least = 3 if techniques.leaves_direct else 2
        found += [
            Technique(True, edges + 2 - t, t)
            for edges in range(2, depth + 1)
            for t in range(edges + 2 - least, first - 1, -1)
        ]
    return found
