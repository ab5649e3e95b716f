"""Faults of a mesh that can be found without casting lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, short_repr

from .faces import repeated
from .patches import Patches
from .zones import face_zones

Index = NDArray[np.int64]

#: Two ends of edges are one place if they are closer than this, in radii of the patches.
_SHORT = 1e-6


@short_repr
@dataclass(frozen=True)
class MeshDiagnosis:
    """The result of :func:`diagnose`. Vertices at the same position count as one.

    Edges do not show that a mesh is inside out as a whole; lines that hit backs of faces do, see :attr:`Segments.dark`.
    """

    #: Duplicates: faces with the corners of an earlier one in the same order. It is arbitrary which one a line hits.
    duplicates: Index
    #: Pairs (k, 2) of other faces that lie on each other, in part or as a whole, and face the same way, such as a door
    #: on a wall. It is arbitrary which of the two a line hits.
    overlaps: Index
    #: Edges of one face only, (e, 2) vertex indices. Two-sided sheets, which have a border, are left out, and so are
    #: edges along which other faces end, divided differently (T-junctions).
    open_edges: Index
    #: Edges of more than two faces.
    crowded_edges: Index
    #: Edges that two faces traverse in the same direction: their orientations are opposite.
    flipped_edges: Index
    #: Number of faces of one side, to which the edges belong.
    one_sided: int

    @property
    def is_closed(self) -> bool:
        """Whether the one-sided faces bound solids or rooms: every edge has two faces of consistent orientation."""
        return self.one_sided > 0 and not any(map(len, (self.open_edges, self.crowded_edges, self.flipped_edges)))

    def __str__(self) -> str:
        pair = f" ({self.overlaps[0, 0]} and {self.overlaps[0, 1]})" if len(self.overlaps) else ""
        found = [
            (self.duplicates, "face given twice", "faces given twice"),
            (self.overlaps, f"pair of faces on each other{pair}", f"pairs of faces on each other{pair}"),
            (self.open_edges, "open edge", "open edges"),
            (self.crowded_edges, "edge of more than two faces", "edges of more than two faces"),
            (self.flipped_edges, "edge between faces turned differently", "edges between faces turned differently"),
        ]
        faults = [f"{len(x)} {one if len(x) == 1 else many}" for x, one, many in found if len(x)]
        kind = "all two-sided" if not self.one_sided else "closed" if self.is_closed else "not closed"
        return kind + "".join(f", {fault}" for fault in faults)


def diagnose(patches: Patches) -> MeshDiagnosis:
    """Find faces that lie on each other, and edges that a closed mesh cannot have; of zones each by itself."""
    zones = face_zones(patches)
    _, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[patches.faces]
    sided = np.flatnonzero(patches.back < 0)
    start = faces[sided].ravel()
    end = np.roll(faces[sided], -1, axis=1).ravel()
    # A triangle repeats its last corner, which is not an edge.
    real = start != end
    where = np.stack([patches.faces[sided].ravel(), np.roll(patches.faces[sided], -1, axis=1).ravel()], axis=1)[real]
    start, end = start[real], end[real]
    zone = np.broadcast_to(zones[sided, None], faces[sided].shape).ravel()[real]
    key = np.minimum(start, end) * (len(place) + 1) + np.maximum(start, end)
    key = key * (zones.max() + 2) + zone + 1
    _, first, inverse, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    forward = np.bincount(inverse.reshape(-1), start < end)
    duplicates, clashing = repeated(patches.vertices, patches.faces), patches.coincident.clashing
    clashing = clashing[zones[clashing[:, 0]] == zones[clashing[:, 1]]]
    return MeshDiagnosis(
        duplicates=duplicates,
        overlaps=clashing[~np.isin(clashing, duplicates).any(axis=1)],
        open_edges=_unmatched(patches, where[first[count == 1]], zone[first[count == 1]]),
        crowded_edges=where[first[count > 2]],
        flipped_edges=where[first[(count == 2) & (forward != 1)]],
        one_sided=len(sided),
    )


def _unmatched(patches: Patches, edges: Index, zone: Index) -> Index:
    """The edges (e, 2) with a part along which no others of their zone run in the opposite direction."""
    return edges[_with_part(patches, edges, zone, lambda sign, runs: (sign * runs).sum(axis=0) != 0)]


def free_edges(patches: Patches, edges: Index) -> NDArray[np.bool_]:
    """(e,) whether an edge has a part along which no other one runs, in any direction."""
    return _with_part(patches, edges, np.zeros(len(edges), np.int64), lambda sign, runs: runs.sum(axis=0) == 1)


def _with_part(
    patches: Patches, edges: Index, zone: Index, is_meant: Callable[[Array, NDArray[np.bool_]], NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """(e,) whether a part of an edge ``is_meant``, by the directions (k, 1) of the edges along a line, and which of
    them run along each of its parts (k, p)."""
    if len(edges) < 2:
        return np.ones(len(edges), bool)
    centre, radius = patches.sphere
    start, end = ((patches.vertices[edges[:, k]] - centre) / radius for k in range(2))
    direction = end - start
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # The same for both directions along a line: the first component that is not zero is positive.
    leading = np.argmax(np.abs(np.round(direction, 6)) > 0, axis=1)
    sign = np.where(np.take_along_axis(direction, leading[:, None], axis=1)[:, 0] < 0, -1.0, 1.0)
    direction *= sign[:, None]
    low, high = ((v * direction).sum(axis=1) for v in (start, end))
    foot = start - low[:, None] * direction
    # Round numbers are not at the border of two steps.
    rounded = np.column_stack([np.round(np.concatenate([direction, foot], axis=1) / _SHORT + 0.37), zone])
    line = np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1)
    found = np.zeros(len(edges), bool)
    order = np.argsort(line, kind="stable")
    for members in np.split(order, np.cumsum(np.bincount(line))[:-1]):
        first, last = np.minimum(low, high)[members], np.maximum(low, high)[members]
        ends = np.unique(np.concatenate([first, last]))
        middle = (ends[1:] + ends[:-1])[np.diff(ends) > _SHORT] / 2
        runs = (first[:, None] < middle) & (middle < last[:, None])
        found[members] = (runs & is_meant(sign[members, None], runs)).any(axis=1)
    return found
