"""Capacity of the store of light vertices, and the groups of paths into which it divides a pass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, free_memory
from etendue.transport import CameraSampler, Moments, Pyramid, Splats, Techniques

from .numbers import Lanes

#: Memory for light vertices in bytes, if the run has no memory limit; and their share of a limit.
_BYTES = 600e6
STORE_SHARE = 0.4
#: Capacity beyond the measured number of vertices: a factor, and a number of vertices.
_MARGIN = 1.05
_PAD = 1024


class VertexRoom:
    """Capacity of the store of light vertices of a pass.

    Parameters
    ----------
    bytes_per_vertex: device memory of a vertex, including search structures.
    floats_per_vertex: numbers of a vertex in the array of records.
    memory: memory limit of the run in bytes, or None.
    """

    def __init__(self, bytes_per_vertex: int, floats_per_vertex: int, memory: int | None) -> None:
        #: Mean number of vertices of a light path, measured by a pilot, or by a pass that had too little capacity.
        self.per_path = 0.0
        self._bytes_per_vertex = bytes_per_vertex
        # A device array has fewer than 2^32 numbers.
        most = ((1 << 32) // floats_per_vertex - 2 * _PAD) * bytes_per_vertex
        self._bytes = min(STORE_SHARE * memory if memory else _BYTES, most)

    def capacity(self, paths: int) -> int:
        """Capacity, in vertices, for a number of light paths."""
        return math.ceil(self.per_path * paths * _MARGIN) + _PAD

    def held(self, wanted: float, paths: int) -> bool:
        """Whether the capacity was enough for the ``wanted`` vertices of a number of paths. If not, :attr:`per_path` is
        updated."""
        if wanted <= self.capacity(paths):
            return True
        self.per_path = wanted / paths
        return False

    @property
    def most(self) -> int:
        """Most vertices that fit into memory."""
        return max(1, int(self._bytes / (_MARGIN * self._bytes_per_vertex)))

    def bytes(self, paths: int) -> float:
        """Memory of the vertices of a number of paths, in bytes."""
        return self.per_path * paths * _MARGIN * self._bytes_per_vertex

    def limit_for(self, vertices: int) -> float:
        """Memory limit of a run, in bytes, for which :attr:`most` is ``vertices``."""
        return vertices * _MARGIN * self._bytes_per_vertex / STORE_SHARE

    def groups(self, paths: int) -> int:
        """Number of groups into which light paths are divided, so that the vertices of a group fit into memory.

        Raises :class:`OptionError` if the memory limit is too small for any number of groups."""
        pad = _PAD * self._bytes_per_vertex
        if self._bytes < 4 * pad:
            given, least = (share / STORE_SHARE / 1e6 for share in (self._bytes, 4 * pad))
            raise OptionError(f"a memory limit of {given:.2g} MB is too small; give at least {least:.1f} MB")
        return min(max(1, math.ceil(self.bytes(paths) / (self._bytes - pad))), paths)


def check_pyramid(techniques: Techniques, depth: int, camera: CameraSampler, memory: int | None) -> None:
    """Raise :class:`OptionError` if the layers of a technique pyramid and the light vertices do not fit into memory."""
    needed = Pyramid.bytes(techniques, depth, camera.pixels)
    what = f"a technique pyramid of depth {depth} at {camera.width}x{camera.height} needs {needed / 1e6:.0f} MB"
    how = "lower pyramid_depth or the picture's size"
    if memory is not None and needed > (1.0 - STORE_SHARE) * memory:
        least = needed / (1.0 - STORE_SHARE) / 1e6
        raise OptionError(
            f"{what}, too much for a memory limit of {memory / 1e6:.0f} MB; {how}, or raise the limit to {least:.0f} MB"
        )
    free = free_memory()
    if free is not None and needed > free:
        raise OptionError(f"{what}, but only {free / 1e6:.0f} MB are free; {how}")


@dataclass
class Group:
    """Parameters of one group of light paths and camera paths."""

    role: str  #: prefix of the seed roles
    iteration: int
    seed: int
    radius: float
    light: Lanes  #: the light paths
    camera: mi.UInt32  #: numbers of the camera paths
    pixel: mi.UInt32  #: their pixels
    samples: int  #: camera paths of a pixel
    splats: Splats | None
    pyramid: Pyramid | None
    capacity: int  #: of the vertex store
    moments: Moments | None = None


def concatenated(colours: list[mi.Color3f]) -> mi.Color3f:
    """Colours of several groups of lanes as one array."""
    if len(colours) == 1:
        return colours[0]
    return type(colours[0])(*(dr.concat(list(each)) for each in zip(*colours, strict=True)))
