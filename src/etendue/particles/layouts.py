"""Packed records of particles of equal energy, as a thesis on Metropolis particle tracing lays them out.

[Leeson 2001, sec. 5.7.3] Such particles store no power, since all have the same power in one channel (in the thesis, at
one wavelength). A count says how often a chain has repeated a particle. A record has a position (three floats, or two
parameters of a surface), a tag of the surface, the count, for glossy surfaces a direction in two bytes, and the
channel. Records on the film have a position on the film, a count and a channel.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ParticleError
from .particles import Particles

_TAIL = [("count", "u1"), ("channel", "u1")]
_DIRECTION = [("theta", "u1"), ("phi", "u1")]
_SPACE = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("tag", "u1")]
_SURFACE = [("u", "<f4"), ("v", "<f4"), ("tag", "u1")]
#: Fields of a record by kind; they have 17, 13, 15, 11 and 10 bytes.
RECORDS: dict[str, np.dtype[Any]] = {
    "glossy xyz": np.dtype(_SPACE + _DIRECTION + _TAIL),
    "glossy uv": np.dtype(_SURFACE + _DIRECTION + _TAIL),
    "diffuse xyz": np.dtype(_SPACE + _TAIL),
    "diffuse uv": np.dtype(_SURFACE + _TAIL),
    "film": np.dtype([("x", "<f4"), ("y", "<f4"), *_TAIL]),
}
_MOST = 255


def merged(particles: Particles) -> tuple[Particles, NDArray[np.int64]]:
    """(particles without consecutive repetitions, how often each occurs); the counts sum to the number of particles.
    Particles may differ in path and bounce. A particle with a count above 255 is stored again for the rest."""
    if len(particles) == 0:
        return particles, np.zeros(0, np.int64)
    rows = particles.rows[:, :13]
    begins = np.concatenate([[0], np.flatnonzero((rows[1:] != rows[:-1]).any(1)) + 1])
    counts = np.diff(np.append(begins, len(rows)))
    pieces = -(-counts // _MOST)
    each = np.full(pieces.sum(), _MOST)
    each[np.cumsum(pieces) - 1] = counts - _MOST * (pieces - 1)
    return particles[np.repeat(begins, pieces)], each


def records(particles: Particles, kind: str, counts: ArrayLike = 1, channels: ArrayLike = 0) -> NDArray[Any]:
    """Records of a kind of :data:`RECORDS` other than ``film``. ``counts``: 1 to 255; ``channels``: 0 to 255, for each
    particle or for all.

    A direction has 256 steps of its polar angle and of its azimuth. Raises :class:`ParticleError` for more than 256
    shapes, and for counts that a byte cannot hold."""
    if kind not in RECORDS or kind == "film":
        raise ParticleError(f"records of surfaces are {', '.join(k for k in RECORDS if k != 'film')}, not '{kind}'")
    result = np.zeros(len(particles), RECORDS[kind])
    for name, values in (("tag", particles.shape), ("count", np.asarray(counts)), ("channel", np.asarray(channels))):
        if values.size and (values.min() < 0 or values.max() > _MOST):
            raise ParticleError(f"the {name} of a record is 0 to {_MOST}, not {values.max()}")
        result[name] = values
    names = RECORDS[kind].names or ()
    if "x" in names:
        result["x"], result["y"], result["z"] = particles.position.T
    else:
        result["u"], result["v"] = particles.uv.T
    if "theta" in names:
        x, y, z = particles.direction.T.astype(np.float64)
        result["theta"] = np.clip(np.arccos(np.clip(z, -1, 1)) / np.pi * 256, 0, _MOST)
        result["phi"] = np.clip((np.arctan2(y, x) / (2 * np.pi) % 1) * 256, 0, _MOST)
    return result


def strips(of: NDArray[Any], buffer: int) -> Iterator[bytes]:
    """Records in buffers of ``buffer`` bytes; in a buffer the values of each field are contiguous."""
    step = max(1, buffer // of.itemsize)
    for begin in range(0, len(of), step):
        part = of[begin : begin + step]
        yield b"".join(np.ascontiguousarray(part[name]).tobytes() for name in of.dtype.names or ())


def of_strips(buffers: Iterator[bytes], kind: str) -> NDArray[Any]:
    """Inverse of :func:`strips`."""
    layout, parts = RECORDS[kind], []
    for data in buffers:
        part, place = np.empty(len(data) // layout.itemsize, layout), 0
        for name in layout.names or ():
            size = layout[name].itemsize * len(part)
            part[name] = np.frombuffer(data[place : place + size], layout[name])
            place += size
        parts.append(part)
    return np.concatenate(parts) if parts else np.empty(0, layout)
