"""Surfaces of revolution about z: rings, from segments of their profile, and the flat faces that stand for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from .errors import PatchError

#: Flat faces around the axis, of which a circle is 4e-4 longer than the polygon.
_AROUND = 64
#: Lengths that are none, in sizes of the profile.
_SAME = 1e-9


@dataclass(frozen=True)
class Rings:
    """Rings of surfaces of revolution about the axis z, whose fronts are to the left of the way along the profile.

    profile: (k, 4) r, z, r, z of their segments. of: (f,) the ring that each flat face is a part of.
    """

    profile: Array
    of: NDArray[np.int64]

    @property
    def areas(self) -> Array:
        """(k,) of the round rings, not of their faces."""
        r, z, to_r, to_z = self.profile.T
        return np.asarray(np.pi * (r + to_r) * np.hypot(to_r - r, to_z - z))

    def some(self, faces: NDArray[np.bool_]) -> Rings:
        """The rings of some of the ``faces`` (f,)."""
        kept, of = np.unique(self.of[faces], return_inverse=True)
        return Rings(self.profile[kept], of.reshape(-1))

    def divided(self, max_area: float) -> tuple[Array, NDArray[np.int64]]:
        """The profile of rings of at most ``max_area``, each larger one in parts of equal area, and the ring that each
        is a part of."""
        count = np.maximum(np.ceil(self.areas / max_area * (1 - 1e-12)), 1).astype(np.int64)
        source = np.repeat(np.arange(len(count)), count)
        number = np.arange(len(source)) - np.repeat(np.cumsum(count) - count, count)
        return np.hstack([self._at(source, (number + k) / count[source]) for k in (0, 1)]), source

    def _at(self, ring: NDArray[np.int64], share: Array) -> Array:
        """(m, 2) places on the profile with a share of the area of a ring before them."""
        ends = self.profile[ring]
        r, to_r = ends[:, 0], ends[:, 2]
        radius = np.sqrt(r**2 + share * (to_r**2 - r**2))
        # (radius - r) / (to_r - r), also of cylinders
        along = np.divide(share * (r + to_r), r + radius, out=np.zeros(len(ring)), where=r + radius > 0)
        return ends[:, :2] + along[:, None] * (ends[:, 2:] - ends[:, :2])


def revolved(profile: Array) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Vertices (v, 3), faces (f, 4) and the ring of each face (f,), of rings with a ``profile`` (k, 4)."""
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    x, y = np.cos(angle), np.sin(angle)
    ends, number = np.unique(profile.reshape(-1, 2), axis=0, return_inverse=True)
    r, z = ends[:, :1], ends[:, 1:]
    vertices = np.stack([r * x, r * y, np.broadcast_to(z, (len(ends), _AROUND))], axis=-1)
    begin, end = number.reshape(-1, 2, 1).transpose(1, 0, 2) * _AROUND
    here, after = np.arange(_AROUND), (np.arange(_AROUND) + 1) % _AROUND
    quads = np.stack([begin + here, end + here, end + after, begin + after], axis=-1)
    # On the axis all vertices are one: triangles.
    for rows, faces in ((profile[:, 0] == 0, [0, 1, 2, 2]), (profile[:, 2] == 0, [0, 1, 3, 3])):
        quads[rows] = quads[rows][..., faces]
    return vertices.reshape(-1, 3), quads.reshape(-1, 4), np.repeat(np.arange(len(profile)), _AROUND)


def checked_profile(profile: Any, names: Sequence[str] | None = None) -> Array:
    """The profile (k, 4) of rings, with one number for equal coordinates. ``names``: for messages.

    Raises :class:`PatchError` for numbers that are not finite, radii below zero, rings without area, and rings that lie
    on each other.
    """
    ends = np.array(profile, dtype=np.float64)
    if ends.ndim != 2 or ends.shape[1] != 4 or not len(ends):
        raise PatchError(f"a profile is r, z, r, z of each ring, (k, 4), not shape {ends.shape}")

    def check(bad: Any, what: str) -> None:
        for k in np.flatnonzero(bad)[:1].tolist():
            name = f"ring {k}" if names is None else names[k]
            raise PatchError(
                f"{name} from r = {ends[k, 0]:g}, z = {ends[k, 1]:g} to {ends[k, 2]:g}, {ends[k, 3]:g} {what}"
            )

    check(~np.isfinite(ends).all(axis=1), "is not finite")
    check((ends[:, ::2] < 0).any(axis=1), "has a radius below zero: give the half of the profile with r >= 0")
    size = max(float(ends[:, ::2].max()), float(np.ptp(ends[:, 1::2])))
    ends[:, ::2], ends[:, 1::2] = (_joined(ends[:, k::2], _SAME * size) for k in (0, 1))
    check((ends[:, :2] == ends[:, 2:]).all(axis=1), "has no length: remove it")
    check((ends[:, ::2] == 0).all(axis=1), "lies on the axis and has no area: remove it")
    for k in range(len(ends)):
        begin, along = ends[k, :2], ends[k, 2:] - ends[k, :2]
        length = float(np.hypot(*along))
        places = (ends[k + 1 :].reshape(-1, 2, 2) - begin) @ np.stack([along, (-along[1], along[0])], axis=1) / length
        low, high = places[..., 0].min(axis=1), places[..., 0].max(axis=1)
        shared = np.minimum(high, length) - np.maximum(low, 0)
        is_on = (np.abs(places[..., 1]) <= _SAME * size).all(axis=1) & (shared > _SAME * size)
        for other in np.flatnonzero(is_on)[:1] + k + 1:
            name = f"ring {other}" if names is None else names[other]
            check(np.arange(len(ends)) == k, f"and {name} lie on each other: remove one, or cut what it covers")
    return ends


def _joined(values: Array, slack: float) -> Array:
    """Values of which those that differ by less than ``slack`` are equal, and those as close to zero are zero."""
    known = np.sort(np.append(values.ravel(), 0.0))
    first = np.flatnonzero(np.diff(known, prepend=-np.inf) > slack)
    return np.asarray(known[first][np.searchsorted(known[first], values, side="right") - 1])
