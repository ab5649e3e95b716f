"""The compact photon map: particles of equal energy in a left-balanced kd-tree, 10 to 17 bytes each.

A particle has no power: it is worth ``unit`` for each of its ``count`` duplicates, the states of a Markov chain that
rejected a change [Leeson 2001, sec. 5.7.4]. Five layouts: positions in space or in two parameters, with a direction of
two bytes for glossy surfaces, or none; and points on the film, which are in no tree. The last byte is the wavelength,
here the number of the colour channel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, suggest
from etendue.density import left_balanced, nearest

from ..errors import SurfaceError

_TREE, _COUNT, _DIRECTION, _CHANNEL = ("axis", "u1"), ("count", "u1"), ("direction", "u1", (2,)), ("channel", "u1")


def _layout(coordinates: int, *fields: Any) -> np.dtype[Any]:
    return np.dtype([("position", "<f4", (coordinates,)), *fields])


#: Packed layouts by name.
COMPACT_LAYOUTS = {
    "glossy-xyz": _layout(3, _TREE, _COUNT, _DIRECTION, _CHANNEL),
    "glossy-uv": _layout(2, _TREE, _COUNT, _DIRECTION, _CHANNEL),
    "diffuse-xyz": _layout(3, _TREE, _COUNT, _CHANNEL),
    "diffuse-uv": _layout(2, _TREE, _COUNT, _CHANNEL),
    "film": _layout(2, _COUNT, _CHANNEL),
}
#: Duplicates that a particle can count; a longer stay takes several.
_MOST = 255


@dataclass(frozen=True)
class CompactMap:
    """Packed particles. ``rows``: (n,) of one of :data:`COMPACT_LAYOUTS`, in the order of a left-balanced kd-tree
    (``film``: of the chain). ``unit``: W of a duplicate."""

    rows: NDArray[Any]
    unit: float

    @classmethod
    def packed(
        cls,
        layout: str,
        positions: ArrayLike,
        channels: ArrayLike,
        directions: ArrayLike | None = None,
        unit: float = 1.0,
    ) -> CompactMap:
        """Pack the states of a chain in their order: positions (n, 3) or (n, 2), channels (n,), directions (n, 3) of
        flight, unit vectors, for glossy layouts. A state that is equal to the one before is a duplicate.

        Raises :class:`SurfaceError` for an unknown layout, or arrays that do not fit it.
        """
        if layout not in COMPACT_LAYOUTS:
            raise SurfaceError(f"there is no layout '{layout}'; {suggest(layout, COMPACT_LAYOUTS)}")
        kind = COMPACT_LAYOUTS[layout]
        x, channel = np.asarray(positions, np.float32), np.asarray(channels, np.uint8)
        coordinates = kind["position"].shape[0]
        if x.ndim != 2 or x.shape[1] != coordinates or channel.shape != (len(x),):
            raise SurfaceError(f"'{layout}' takes positions (n, {coordinates}) and a channel each, not {x.shape}")
        is_glossy = "direction" in (kind.names or ())
        if is_glossy != (directions is not None):
            raise SurfaceError(f"'{layout}' {'needs' if is_glossy else 'has no'} directions")
        angles = _angles(directions) if is_glossy else np.zeros((len(x), 2), np.uint8)
        states = np.column_stack([x.view(np.uint32), channel, angles]) if len(x) else np.zeros((0, coordinates + 3))
        first, counts = _runs(states)
        rows = np.zeros(len(first), kind)
        rows["position"], rows["count"], rows["channel"] = x[first], counts, channel[first]
        if is_glossy:
            rows["direction"] = angles[first]
        if layout != "film" and len(rows):
            order, axes = left_balanced(rows["position"].astype(np.float64))
            rows = rows[order]
            rows["axis"] = axes
        return cls(rows, float(unit))

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def states(self) -> int:
        """States of the chain: the sum of all counts."""
        return int(self.rows["count"].sum(dtype=np.int64))

    @property
    def power(self) -> Array:
        """(n, 3) W of each particle, by channel."""
        power = np.zeros((len(self), 3))
        power[np.arange(len(self)), self.rows["channel"]] = self.unit * self.rows["count"]
        return power

    @property
    def directions(self) -> Array:
        """(n, 3) of flight, of glossy layouts; within 0.013 rad."""
        theta, phi = ((self.rows["direction"].astype(np.float64).T + 0.5) / 256) * np.array([[np.pi], [2 * np.pi]])
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)

    def nearest(self, at: ArrayLike, k: int) -> tuple[NDArray[np.int64], Array]:
        """(places, squared distances) of the ``k`` particles nearest to a point, found in the packed tree itself."""
        if "axis" not in (self.rows.dtype.names or ()):
            raise SurfaceError("points on the film are in no tree")
        point = np.asarray(at, np.float64)
        return nearest(self.rows["position"].astype(np.float64), self.rows["axis"], point, k)


def _angles(directions: Any) -> NDArray[np.uint8]:
    d = np.asarray(directions, np.float64)
    theta, phi = np.arccos(np.clip(d[:, 2], -1, 1)), np.arctan2(d[:, 1], d[:, 0]) % (2 * np.pi)
    return np.minimum(np.stack([theta / np.pi, phi / (2 * np.pi)], axis=1) * 256, 255).astype(np.uint8)


def _runs(states: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(first index, length) of runs of equal rows, cut at the largest count."""
    if not len(states):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    begin = np.flatnonzero(np.concatenate([[True], (states[1:] != states[:-1]).any(axis=1)]))
    length = np.diff(np.append(begin, len(states)))
    pieces = -(-length // _MOST)
    first = np.repeat(begin, pieces)
    number = np.arange(len(first)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    counts = np.minimum(np.repeat(length, pieces) - number * _MOST, _MOST)
    return first, counts
