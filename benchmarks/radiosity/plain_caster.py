"""A ray caster without a tree that counts its tests of polygons, to show how many tests a hierarchy of boxes saves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.radiosity import Part
from etendue.radiosity.hierarchical_multipath.lists import Lists, PartRays
from etendue.radiosity.hierarchical_multipath.parts import Tree
from etendue.radiosity.hierarchical_multipath.regions import Regions

Index = NDArray[np.int64]
How = Literal["all", "boxes", "conservative", "listed"]

#: Largest number of polygons associated with a region in the mode ``listed``.
MOST_LISTED = 24


@dataclass(frozen=True)
class PlainHits:
    """``hits``: (k, 2) scene node and face of its part, -1 without a hit; ``distance``: (k,). ``tests``: number of
    polygon tests, ``box_tests``: of box tests."""

    hits: Index
    distance: Array
    tests: int
    box_tests: int


class PlainCaster:
    """Rays and lines against the polygons of a scene of parts, one by one.

    lists: the preprocess, which associates polygons with regions.
    """

    def __init__(self, tree: Tree, rays: Mapping[Part, PartRays], lists: Mapping[Part, Lists] | None = None) -> None:
        self.tree = tree
        known = [rays[part] for part in tree.parts]
        begins = np.cumsum([0, *(len(r.faces) for r in known)])
        self._faces = np.concatenate([r.faces for r in known])
        self._normals = np.concatenate([r.normals for r in known])
        self._boxes = np.array([known[k].own for k in tree.part])
        self._matrices = np.linalg.inv(tree.world)[:, :3]
        self._known, self._lists = known, lists
        regions = Regions() if lists is None else next(iter(lists.values())).regions
        self._regions = regions
        self._first = np.array([[begins[k], begins[k + 1], k * len(regions)] for k in tree.part])

    def first_hits(self, origins: Array, directions: Array, how: How = "all") -> PlainHits:
        """First hits of rays (k, 3).

        ================ ============================================================================================
        ``all``          every polygon is tested
        ``boxes``        polygons of a copy are tested only if the ray meets its box
        ``conservative`` in a box, only polygons that rays through the region where the ray enters may meet: exact
        ``listed``       in a box, polygons that lines of the preprocess met first behind the region; the nearest hit
                         counts as the first in the box, though an unlisted polygon may be nearer; all if none is hit
        ================ ============================================================================================
        """
        starts, items = np.zeros(0, np.int64), np.zeros(0, np.int64)
        if how in ("conservative", "listed"):
            starts, items = self._polygons(how)
        hits, distance = np.empty((len(origins), 2), np.int64), np.empty(len(origins))
        tests = _loops().first_hits(
            *(origins, directions, self._matrices, self._first, self._faces, self._normals, self._boxes),
            *(starts, items, np.array([self._regions.grid, self._regions.around, self._regions.up])),
            *(how != "all", how == "listed", hits, distance),
        )
        return PlainHits(hits, distance, *tests)

    def line_tests(self, origins: Array, directions: Array, how: Literal["all", "boxes", "top"] = "all") -> int:
        """Number of polygon tests that find all hits of lines; ``top``: only of the root, without the copies."""
        if how == "boxes":
            return int(_loops().line_tests(origins, directions, self._matrices, self._first, self._boxes))
        nodes = slice(None) if how == "all" else slice(0, 1)
        return int((self._first[nodes, 1] - self._first[nodes, 0]).sum()) * len(origins)

    def _polygons(self, how: How) -> tuple[Index, Index]:
        """First indices into the faces for each part and region, and the faces."""
        found: list[Index] = []
        for k, part in enumerate(self.tree.parts):
            if how == "conservative":
                found += beams(self._known[k].faces, self._known[k].own, self._regions)
                continue
            assert self._lists is not None
            listed, none = self._lists[part].polygons, np.zeros(0, np.int64)
            found += [listed.get(r, none)[:MOST_LISTED] for r in range(len(self._regions))]
        return np.cumsum([0, *map(len, found)]), np.concatenate(found)


def beams(faces: Array, box: Array, regions: Regions) -> list[Index]:
    """For each region of a box (2, 3) the indices of the faces (f, 4, 3) that rays entering there may meet, and a few
    more.

    These rays lie in the half-spaces that bound the beam of the region: they miss faces outside any half-space.
    """
    found: list[Index] = []
    size = np.linalg.norm(box[1] - box[0])
    for face in range(6):
        axis, is_high = face // 2, face % 2 == 1
        b, c = (axis + 1) % 3, (axis + 2) % 3
        depth = (box[1, axis] - faces[:, :, axis]) if is_high else (faces[:, :, axis] - box[0, axis])
        across = np.stack([faces[:, :, b], faces[:, :, c]], axis=2)
        low, step = box[0, [b, c]], (box[1] - box[0])[[b, c]] / regions.grid
        for place in np.ndindex(regions.grid, regions.grid):
            corner = low + np.array(place) * step
            for ring in range(regions.up):
                for sector in range(regions.around):
                    met = np.ones(len(faces), dtype=bool)
                    for way, slope in _bounds(ring, sector, regions):
                        edge = (way * np.where(way > 0, corner + step, corner)).sum()
                        met &= (across @ way <= edge + slope * depth + 1e-9 * size).any(axis=1)
                    found.append(np.flatnonzero(met))
    return found


def _bounds(ring: int, sector: int, regions: Regions) -> list[tuple[Array, float]]:
    """Directions perpendicular to the axis of a face, and for each the largest advance per depth of rays through a
    region."""
    width = 2 * np.pi / regions.around
    middle = (sector + 0.5) * width
    slowest = np.sqrt(ring / max(regions.up - ring, 1e-300))
    fastest = np.sqrt((ring + 1) / (regions.up - ring - 1)) if ring + 1 < regions.up else np.inf
    half = min(width / 2, np.pi)
    angles = [0, np.pi / 2, np.pi, 3 * np.pi / 2, middle, middle + np.pi]
    angles += [middle - half - np.pi / 2, middle + half + np.pi / 2] if half < np.pi / 2 else []
    result = []
    for angle in angles:
        off = abs((angle - middle + np.pi) % (2 * np.pi) - np.pi)
        along = np.cos(max(off - half, 0.0))
        slope = fastest * along if along > 1e-12 else slowest * along
        if np.isfinite(slope):
            result.append((np.array([np.cos(angle), np.sin(angle)]), slope + 1e-9))
    return result


def _loops() -> Any:
    from . import plain_loops

    return plain_loops
