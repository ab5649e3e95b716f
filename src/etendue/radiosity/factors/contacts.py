"""Faces that lie on each other: which one is in front, and what is left to be seen of their sides."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, permutations, product

import numpy as np

from etendue.core import Array, sparse
from etendue.surfaces import Patches, surfaces_of

from ..compiling import compiled
from ..errors import RadiosityError
from .occluders import Index

#: Polygons that are not wider than this do not count, in radii of the scene.
_THIN = 1e-6
#: A surface is flat if its corners are this close to a plane, in radii of the scene: a few times rounding.
_FLAT = 3e-6
#: Most faces in one place.
_MOST = 6
#: Places that are tried in the overlap of two faces.
_TRIED = 8
#: Costs of an order of faces that breaks a known one, of air or solids that do not take turns, of surfaces that go
#: through each other, of a large face in front of a small one, and of backs in contact near a solid, or fronts in
#: contact without one.
_KNOWN, _TURNS, _BODY, _SIZE, _CONTACT = 1e5, 1e3, 30.0, 1.0, 0.01


@dataclass(frozen=True)
class Cover:
    """A face that lies on a side of another one, and the ``area`` in contact."""

    face: int
    area: float


@dataclass(frozen=True)
class Contacts:
    """Faces ``corners`` (f, 4, 3) with ``planes`` (f, 4), in radii of the scene, of which some lie on each other: these
    are in one plane exactly. ``in_front``: of such faces a and b, whether b is in front of a. ``partners``: of each of
    them, the others."""

    corners: Array
    planes: Array
    in_front: dict[tuple[int, int], bool]
    partners: dict[int, list[int]] = field(default_factory=lambda: defaultdict(list))

    def __post_init__(self) -> None:
        for a, b in self.in_front:
            self.partners[a].append(b)

    @classmethod
    def of(cls, patches: Patches) -> Contacts:
        """Find which of the faces that lie on each other is in front.

        Along any line air and solids take turns, and rays find which of them is on both sides. Fronts are in contact
        where solids touch, such as a box and the floor; backs, where rooms share a wall, and in thin plates. Sheets
        with two sides and obstacles are in the air; there may be anything behind a surface that is flat. Where this
        leaves a choice, the smaller one is in front, such as a door on a wall, or the first of equals.

        Raises :class:`RadiosityError` for sheets on each other, and for too many faces in one place.
        """
        centre, radius = patches.sphere
        corners = (patches.vertices[patches.faces] - centre) / radius
        planes = np.column_stack([patches.face_normals, (patches.face_normals * corners.mean(axis=1)).sum(axis=1)])
        if not len(patches.coincident.pairs):
            return cls(corners, planes, {})
        corners, planes = _in_common_planes(patches, corners, planes)
        return cls(corners, planes, _Stacks(patches, corners, planes).in_front)

    def covered(self, face: int, front: bool) -> bool:
        """Whether anything lies on a side of a face."""
        return any(self.in_front[face, other] == front for other in self.partners.get(face, ()))

    def covers(self, face: int, front: bool) -> list[int]:
        """The faces that lie on a side, the nearest first: with the fewest of the others between."""
        found = {other for other in self.partners.get(face, ()) if self.in_front[face, other] == front}

        def between(other: int) -> int:
            return sum(self._is_between(face, k, other) for k in self.partners[other] if k in found)

        return sorted(sorted(found), key=between)

    def edges(self, face: int) -> Array:
        """(4, 4) planes through the edges of a face, along its normal, that face inward; of a triangle, one twice."""
        planes = _inward(ring(self.corners[face]), self.planes[face, :3])
        return planes[[0, 1, 2, len(planes) - 1]]

    def uncovered(self, face: int, front: bool) -> tuple[list[Array], list[Cover]]:
        """The convex parts (k, 3) of a side that nothing lies on, and what lies on the others."""
        normal = self.planes[face, :3]
        parts, touching = [ring(self.corners[face])], []
        for other in self.covers(face, front):
            shape, area, left = _turned(ring(self.corners[other]), normal, self.planes[other]), 0.0, []
            for part in parts:
                outside, inside = _difference(part, shape, normal)
                left += outside
                area += inside
            parts = left
            if area > 0:
                touching.append(Cover(other, area))
        return parts, touching

    def facing_front(self, face: int, front: bool, other: int) -> bool:
        """Whether it is the front of another face that is towards a side of a face."""
        return front == bool(self.planes[face, :3] @ self.planes[other, :3] < 0)

    def _is_between(self, face: int, middle: int, other: int) -> bool:
        """Whether a face is between two others: on that side of the other one that is towards the first."""
        if (other, middle) not in self.in_front:
            return False
        towards = self.facing_front(face, self.in_front[face, other], other)
        return self.in_front[other, middle] == towards


class _Stacks:
    """Orders of faces in one place, which lie on each other in part; ``in_front`` as of :class:`Contacts`."""

    def __init__(self, patches: Patches, corners: Array, planes: Array) -> None:
        self.patches, self.corners, self.planes = patches, corners, planes
        self.is_sided = (patches.back < 0) & (patches.front >= 0)
        self.is_flat = _are_flat(patches, corners, planes)
        self.bodies = _bodies(patches, corners, planes)
        self.in_front: dict[tuple[int, int], bool] = {}
        self._partners: dict[int, set[int]] = defaultdict(set)
        pairs: list[tuple[int, int]] = list(map(tuple, patches.coincident.pairs.tolist()))
        for a, b in pairs:
            self._partners[a].add(b)
            self._partners[b].add(a)
            if patches.back[a] >= 0 and patches.back[b] >= 0:
                self._refuse(a, b, "and have two sides, so that it is not known which one is in front")
        flat = patches.coincident.flat
        for a, b in pairs:
            if flat[a] and flat[b] and self._are_opposite(a, b):
                self._decide(a, b, False)
        found = {(a, b): self._place(a, b) for a, b in pairs if (a, b) not in self.in_front}
        places = {pair: place for pair, place in found.items() if place is not None}
        points = np.array([point for point, _ in places.values()]).reshape(-1, 3)
        normals = np.array([planes[a, :3] for a, _ in places]).reshape(-1, 3)
        seen = compiled("factors.openness").openness(points, normals, corners, planes, self.is_sided)
        states = dict(zip(places, np.sign(seen).tolist(), strict=True))
        # Places of few faces tell more.
        for a, b in sorted(places, key=lambda pair: len(places[pair][1])):
            _, stack = places[a, b]
            if len(stack) > _MOST:
                self._refuse(a, b, f"with {len(stack) - 2} others")
            order = self._best(stack, states[a, b])
            self._decide(a, b, order.index(b) < order.index(a))

    def _refuse(self, a: int, b: int, why: str) -> None:
        raise RadiosityError(refusal(self.patches, a, b, why))

    def _decide(self, a: int, b: int, b_in_front: bool) -> None:
        self.in_front[a, b] = b_in_front
        self.in_front[b, a] = b_in_front == self._are_opposite(a, b)

    def _are_opposite(self, a: int, b: int) -> bool:
        return bool(self.planes[a, :3] @ self.planes[b, :3] < 0)

    def _place(self, a: int, b: int) -> tuple[Array, list[int]] | None:
        """A point where two faces overlap, with few others, and all faces there, the first face first."""
        normal = self.planes[a, :3]
        shapes = {k: _turned(ring(self.corners[k]), normal, self.planes[k]) for k in (a, b)}
        overlap = _overlap(shapes[a], shapes[b], normal)
        if overlap is None:
            return None
        near = sorted(self._partners[a] & self._partners[b])
        parts = [overlap]
        for k in near:
            shape = _turned(ring(self.corners[k]), normal, self.planes[k])
            parts = [left for part in parts for left in _difference(part, shape, normal)[0]]
        if parts:
            return max(parts, key=compiled("factors.occlusion").polygon_area).mean(axis=0), [a, b]
        # Not on the edges of any of them, which a face of several parts has in its middle.
        points = np.random.default_rng(0).dirichlet(np.ones(len(overlap)), _TRIED) @ overlap
        inside = [[_inside(self.corners[k], self.planes[k], x) for k in near] for x in points]
        best = min(range(_TRIED), key=lambda k: (min(map(abs, inside[k])) < _THIN, sum(x > 0 for x in inside[k])))
        return points[best], [a, b, *(k for k, x in zip(near, inside[best], strict=True) if x > 0)]

    def _best(self, stack: list[int], seen: Sequence[int]) -> tuple[int, ...]:
        """The best order of faces along the normal of the first one, from its front to its back, where air (1), solids
        (-1) or unknown things (0) are ``seen``."""
        up = {k: k == stack[0] or not self._are_opposite(stack[0], k) for k in stack}
        return min(permutations(stack), key=lambda order: self._cost(order, up, seen))

    def _cost(self, order: tuple[int, ...], up: dict[int, bool], seen: Sequence[int]) -> float:
        cost, state = 0.0, seen[0]
        for k in order:
            before, after = self._states(k, up[k])
            cost += _TURNS * (before * state < 0)
            state = after
        cost += _TURNS * (state * seen[1] < 0)
        for above, below in combinations(order, 2):
            known = self.in_front.get((below, above))
            cost += _KNOWN * (known is not None and known != up[below])
            cost += _BODY * (self._body(above, up) < 0 < self._body(below, up))
            if self.is_sided[above] and self.is_sided[below] and up[above] != up[below]:
                cost += _CONTACT * (up[above] == (-1 in seen))
            elif self.is_sided[above] or self.is_sided[below]:
                small, large = sorted((above, below), key=self._size)
                cost += _SIZE * ((small == above) != up[small if self.is_sided[small] else large])
        return cost

    def _states(self, face: int, up: bool) -> tuple[int, int]:
        """What must be before a face and behind it, in front of it if it is ``up``: anything (0) behind a plate."""
        if not self.is_sided[face]:
            return 1, 1
        back = 0 if self.is_flat[face] else -1
        return (1, back) if up else (back, 1)

    def _body(self, face: int, up: dict[int, bool]) -> int:
        """1 if the surface of a face goes on above it, -1 if below; 0 if on both sides, or on none."""
        return int(self.bodies[face]) * (1 if up[face] else -1)

    def _size(self, face: int) -> tuple[float, int]:
        """Of equal faces, the first one counts as the smaller."""
        return float(np.float32(self.patches.face_areas[face])), face


def refusal(patches: Patches, a: int, b: int, why: str) -> str:
    """A message that names two faces that lie on each other."""
    a, b = patches.numbers[[a, b]]
    return f"faces {a} and {b} lie on each other {why}: remove one, or cast lines (ABuffer, or method lines)"


def ring(corners: Array) -> Array:
    """(k, 3) the three or four corners of a face (4, 3)."""
    return corners[:3] if (corners[2] == corners[3]).all() else corners


def quadrilaterals(polygon: Array) -> list[Array]:
    """Faces (4, 3) that a convex polygon consists of."""
    count = len(polygon)
    rows = [[0, k, k + 1, min(k + 2, count - 1)] for k in range(1, count - 1, 2)]
    return [polygon[row] for row in rows]


def _in_common_planes(patches: Patches, corners: Array, planes: Array) -> tuple[Array, Array]:
    """Corners and planes, with each face moved into the plane of the largest one that it lies on."""
    corners, planes, partners = corners.copy(), planes.copy(), defaultdict(list)
    for a, b in patches.coincident.pairs.tolist():
        partners[a].append(b)
        partners[b].append(a)
    rank = {face: k for k, face in enumerate(sorted(partners, key=lambda f: (-patches.face_areas[f], f)))}
    for face in rank:
        largest = min(partners[face], key=rank.__getitem__)
        if rank[largest] > rank[face]:
            largest = face
        plane = planes[largest]
        corners[face] -= (corners[face] @ plane[:3] - plane[3])[:, None] * plane[:3]
        planes[face] = plane if planes[face, :3] @ plane[:3] > 0 else -plane
    return corners, planes


def _are_flat(patches: Patches, corners: Array, planes: Array) -> dict[int, bool]:
    """Whether all faces of the connected surface of a face that lies on others are in its plane."""
    part, lying = surfaces_of(patches), np.unique(patches.coincident.pairs)
    # The plane of the largest of these faces tells: if the surface is flat, those of the others are the same.
    largest, bent = np.full(part.max() + 1, -1), np.zeros(part.max() + 1, bool)
    ascending = lying[np.argsort(patches.face_areas[lying], kind="stable")]
    largest[part[ascending]] = ascending
    ours = np.flatnonzero(largest[part] >= 0)
    plane = planes[largest[part[ours]]]
    heights = np.abs((corners[ours] * plane[:, None, :3]).sum(axis=2) - plane[:, 3:]).max(axis=1)
    bent[part[ours[heights >= _FLAT]]] = True
    return dict(zip(lying.tolist(), (~bent[part[lying]]).tolist(), strict=True))


def _bodies(patches: Patches, corners: Array, planes: Array) -> Index:
    """(f,) where the surface that a face belongs to goes on, across its edges and those of its neighbours in the same
    plane: 1 in front of the face, -1 behind it, 0 for both or none."""
    _, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    of_edge: dict[tuple[int, int], list[int]] = defaultdict(list)
    for face, ends in enumerate(place.reshape(-1)[patches.faces].tolist()):
        for start, end in zip(ends, [*ends[1:], ends[0]], strict=True):
            if start != end:
                of_edge[start, end].append(face)
    beside, goes_on = [], np.zeros((len(corners), 2), bool)
    for (start, end), faces in of_edge.items():
        for face, other in product(faces, of_edge.get((end, start), ())):
            heights = corners[other] @ planes[face, :3] - planes[face, 3]
            if np.abs(heights).max() > _FLAT:
                goes_on[face, int(heights.sum() < 0)] = True
            elif planes[face, :3] @ planes[other, :3] > 0:
                beside.append((face, other))
    count, pairs = len(corners), np.array(beside, np.int64).reshape(-1, 2).T
    from scipy.sparse.csgraph import connected_components

    _, panel = connected_components(sparse().coo_array((np.ones(pairs.shape[1]), tuple(pairs)), (count, count)))
    before, behind = (np.bincount(panel, side)[panel] > 0 for side in goes_on.T)
    return before.astype(np.int64) - behind


def _turned(polygon: Array, normal: Array, plane: Array) -> Array:
    """A polygon in this plane, counterclockwise around the normal."""
    return polygon if plane[:3] @ normal > 0 else polygon[::-1]


def _overlap(part: Array, other: Array, normal: Array) -> Array | None:
    """What a convex polygon has in common with another one in its plane; nothing if that is thin."""
    for plane in _inward(other, normal):
        if not len(part := _cut(part, plane)):
            return None
    return part if _is_wide(part) else None


def _difference(part: Array, other: Array, normal: Array) -> tuple[list[Array], float]:
    """The convex parts of a convex polygon outside of another one in its plane, and the area inside."""
    loops = compiled("factors.occlusion")
    if _overlap(part, other, normal) is None:
        return [part], 0.0
    whole, left = loops.polygon_area(part), []
    for plane in _inward(other, normal):
        outside, part = _cut(part, -plane), _cut(part, plane)
        if len(outside) and _is_wide(outside):
            left.append(outside)
    return left, whole - sum(loops.polygon_area(outside) for outside in left)


def _inward(polygon: Array, normal: Array) -> Array:
    """(k, 4) planes through the edges of a polygon, along its normal, that face inward."""
    along = np.roll(polygon, -1, axis=0) - polygon
    across = np.cross(normal, along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.column_stack([across, (across * polygon).sum(axis=1)])


def _cut(polygon: Array, plane: Array) -> Array:
    """The part of a convex polygon in front of a plane; (0, 3) for none."""
    if len(polygon) < 3:
        return polygon[:0]
    result = np.empty((len(polygon) + 2, 3))
    count = compiled("factors.occlusion").cut(polygon, len(polygon), *plane, result)
    return result[: count if count >= 3 else 0]


def _is_wide(polygon: Array) -> bool:
    length = float(np.linalg.norm(polygon - polygon[0], axis=1).max())
    return bool(compiled("factors.occlusion").polygon_area(polygon) > _THIN * length)


def _inside(corners: Array, plane: Array, point: Array) -> float:
    """How far a point in the plane of a face is from its edges, negative outside."""
    return float((_inward(ring(corners), plane[:3]) @ [*point, -1]).min())
