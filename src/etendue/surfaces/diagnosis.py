"""Faults of a mesh that can be found without casting lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import short_repr

from .faces import repeated
from .patches import Patches

Index = NDArray[np.int64]


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
    #: Edges of one face only, (e, 2) vertex indices; two-sided sheets, which have a border, are left out.
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
    """Find faces that lie on each other, and edges that a closed mesh cannot have."""
    _, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[patches.faces]
    sided = np.flatnonzero(patches.back < 0)
    start = faces[sided].ravel()
    end = np.roll(faces[sided], -1, axis=1).ravel()
    # A triangle repeats its last corner, which is not an edge.
    real = start != end
    where = np.stack([patches.faces[sided].ravel(), np.roll(patches.faces[sided], -1, axis=1).ravel()], axis=1)[real]
    start, end = start[real], end[real]
    key = np.minimum(start, end) * (len(place) + 1) + np.maximum(start, end)
    _, first, inverse, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    forward = np.bincount(inverse.reshape(-1), start < end)
    duplicates, clashing = repeated(patches.vertices, patches.faces), patches.coincident.clashing
    return MeshDiagnosis(
        duplicates=duplicates,
        overlaps=clashing[~np.isin(clashing, duplicates).any(axis=1)],
        open_edges=where[first[count == 1]],
        crowded_edges=where[first[count > 2]],
        flipped_edges=where[first[(count == 2) & (forward != 1)]],
        one_sided=len(sided),
    )
