"""Strips: the values of one attribute of the particles of a chunk, each coded separately."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import library

from .coders import coded, coder


def kernels() -> ModuleType:
    """The loops that pack fields. Raises :class:`etendue.core.BackendError` if Numba is not installed."""
    library("numba", "packing particles", "particles")
    from . import kernels as loops

    return loops


def ordering() -> ModuleType:
    """The loops that sort particles. Raises as :func:`kernels`."""
    library("numba", "packing particles", "particles")
    from . import ordering as loops

    return loops


@dataclass
class Chunk:
    """Particles as bytes: ``head`` is plain values for JSON; ``strips`` are the payload."""

    head: dict[str, Any]
    strips: list[bytes]


class Packing:
    """Collects the strips of a chunk."""

    def __init__(self, coder_name: str) -> None:
        self._coder = coder_name
        self._known: list[list[Any]] = []
        self._strips: list[bytes] = []

    def add(self, data: bytes | NDArray[Any]) -> None:
        """Add a strip of bytes."""
        plain = data if isinstance(data, bytes) else np.ascontiguousarray(data).view(np.uint8).ravel()
        used, made = coded(plain, self._coder)
        self._known.append([used, len(plain), len(made)])
        self._strips.append(made)

    def add_planes(self, values: NDArray[np.uint32] | NDArray[np.uint64]) -> None:
        """Add numbers as planes: their lowest bytes, their second bytes and so on, as many as the largest one needs,
        after a strip with the number of planes."""
        planes = -(-int(values.max(initial=0)).bit_length() // 8)
        self.add(bytes([planes]))
        parts = values.view(np.uint8).reshape(len(values), -1)
        for plane in range(planes):
            self.add(parts[:, plane])

    def chunk(self, head: dict[str, Any]) -> Chunk:
        """The chunk."""
        return Chunk(head | {"strips": self._known}, self._strips)


class Strips:
    """The strips of a chunk in their order."""

    def __init__(self, head: dict[str, Any], payload: bytes) -> None:
        self._all = self._decoded(head["strips"], payload)

    @staticmethod
    def _decoded(known: list[Any], payload: bytes) -> Iterator[bytes]:
        place = 0
        for name, length, size in known:
            plain = coder(name).decode(payload[place : place + size], int(length))
            if len(plain) != length:
                raise ValueError(f"a strip has {len(plain)} bytes instead of {length}")
            yield plain
            place += size

    def next(self) -> NDArray[np.uint8]:
        """The next strip. Raises ``ValueError`` if its length is wrong, and the errors of its coder."""
        return np.frombuffer(next(self._all), np.uint8)

    def planes(self, count: int, kind: type[np.uint32] | type[np.uint64] = np.uint32) -> NDArray[Any]:
        """The next numbers, as added by :meth:`Packing.add_planes`."""
        values = np.zeros(count, kind)
        parts = values.view(np.uint8).reshape(count, values.itemsize)
        for plane in range(self.next()[0]):
            parts[:, plane] = self.next()
        return values


def differences(values: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Differences of neighbours modulo 2^32, coded so that small differences of either sign are small numbers."""
    steps = np.diff(values, prepend=np.uint32(0)).view(np.int32)
    return ((steps << 1) ^ (steps >> 31)).view(np.uint32)


def summed(steps: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Inverse of :func:`differences`."""
    plain = (steps >> np.uint32(1)) ^ (np.uint32(0) - (steps & np.uint32(1)))
    return np.cumsum(plain, dtype=np.uint32)
