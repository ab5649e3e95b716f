"""How many light vertices a pass stores, and into what memory they must fit."""

from __future__ import annotations

import math

from etendue.core import OptionError

#: Room for light vertices without a memory limit, in bytes, and the share of a limit that they may take.
_BYTES = 600e6
STORE_SHARE = 0.4
#: Room beyond what was measured: a factor, and vertices.
_MARGIN = 1.05
_PAD = 1024


class VertexRoom:
    """Room for the light vertices of a pass.

    Parameters
    ----------
    bytes_per_vertex: device memory that a vertex takes, search structures included.
    floats_per_vertex: numbers of a vertex in the one array that holds all of them.
    memory: limit of the whole run in bytes, or None.
    """

    def __init__(self, bytes_per_vertex: int, floats_per_vertex: int, memory: int | None) -> None:
        #: Vertices that a light path stores, as a pilot measured it, or a pass that it had guessed too low for.
        self.per_path = 0.0
        self._bytes_per_vertex = bytes_per_vertex
        # What the device's arrays can number is the limit where memory is not.
        most = ((1 << 32) // floats_per_vertex - 2 * _PAD) * bytes_per_vertex
        self._bytes = min(STORE_SHARE * memory if memory else _BYTES, most)

    def capacity(self, paths: int) -> int:
        """Vertices to make room for when so many light paths are traced."""
        return math.ceil(self.per_path * paths * _MARGIN) + _PAD

    def held(self, wanted: float, paths: int) -> bool:
        """Whether the ``wanted`` vertices of so many paths had room; if not, :attr:`per_path` is now what they need."""
        if wanted <= self.capacity(paths):
            return True
        self.per_path = wanted / paths
        return False

    @property
    def most(self) -> int:
        """Vertices that fit into memory."""
        return max(1, int(self._bytes / (_MARGIN * self._bytes_per_vertex)))

    def bytes(self, paths: int) -> float:
        """Memory that the vertices of so many paths take."""
        return self.per_path * paths * _MARGIN * self._bytes_per_vertex

    def limit_for(self, vertices: int) -> float:
        """The limit of a run, in bytes, under which :attr:`most` is so many vertices."""
        return vertices * _MARGIN * self._bytes_per_vertex / STORE_SHARE

    def groups(self, paths: int) -> int:
        """Groups to split so many light paths into, so that the vertices of each fit.

        Raises :class:`OptionError` if little more than the padding would."""
        pad = _PAD * self._bytes_per_vertex
        if self._bytes < 4 * pad:
            given, least = (share / STORE_SHARE / 1e6 for share in (self._bytes, 4 * pad))
            raise OptionError(f"a memory limit of {given:.2g} MB is too small; give at least {least:.1f} MB")
        return min(max(1, math.ceil(self.bytes(paths) / (self._bytes - pad))), paths)
