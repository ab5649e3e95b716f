"""Which sides of faces are outside: by the parity of what rays cross, one answer for faces that share edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device, short_repr

from .diagnosis import free_edges
from .patches import Patches
from .rays.raycasting import STEP, RayScene
from .zones import zone_names, zone_parts

Index = NDArray[np.int64]

#: Rays from each side of a face, and at least from each side of a set of faces.
_RAYS, _LEAST = 16, 256
#: A set of faces is turned, or left, if the shares of rays that find its two sides outside differ by this: those of a
#: closed solid by 1, those of a flat house without floor by less.
_DECIDED = 0.15
#: A sheet stands upright if its projection to the ground is less than this part of its area.
_UPRIGHT = 0.1
#: Most crossings of a ray.
_CROSSINGS = 1000
#: A set of faces is a sheet if its faces see of it less than this part of the sphere, on average over some of them.
#: Those of a solid see half.
_SHEET, _SAMPLES = 0.25, 64


@short_repr
@dataclass(frozen=True)
class Orientation:
    """The result of :func:`orientation`, by the numbers of faces in the file (:attr:`Patches.numbers`)."""

    #: Faces that are turned the wrong way.
    wrong: Index
    #: Faces both sides of which see the outside alike, such as sheets that stand upright.
    undecided: Index


def orientation(patches: Patches, inward: bool = False, up: str = "z", seed: int = 0) -> Orientation:
    """Find the faces whose fronts are not outside of solids; ``inward``: not inside of rooms.

    A side of a face is outside if a ray from it crosses an even number of faces. Faces that share edges which no other
    face has are a set: they are turned alike, however the file has turned them, and all their rays decide together.
    The fronts of open sheets, such as ground with houses on it, are ``up`` (an axis) as a whole, and rays that meet
    them decide nothing, unless the sheets stand upright, or other faces run along all of their border, as around the
    roof of a room. Faces whose backs are patches have no wrong side. Zones are
    looked at each by itself.
    """
    if len(zone_names(patches)) > 1:
        of_zones = [orientation(part.only(~part.empty)[0], inward, up, seed) for _, part, _ in zone_parts(patches)]
        return Orientation(*(np.unique(np.concatenate(found)) for found in zip(*map(_both, of_zones), strict=True)))
    sided = np.flatnonzero((patches.back < 0) & (patches.front >= 0))
    if len(sided) == 0:
        return Orientation(np.zeros(0, np.int64), np.zeros(0, np.int64))
    sets, turn, free = _sets(patches, sided)
    rng = np.random.default_rng([seed, 0x0E1])
    areas, rise = patches.face_areas[sided], patches.face_normals[sided, "xyz".index(up)]
    risen = np.bincount(sets, turn * areas * rise) / np.bincount(sets, areas)
    sheets = _sheets(patches, sided, sets, turn, rng) & (np.abs(risen) >= _UPRIGHT)
    ground = sheets & free
    rays = np.maximum(_RAYS, -(-_LEAST // np.bincount(sets)))[sets]
    votes, cast = (np.bincount(sets, v) for v in _votes(patches, sided, rays, ground[sets], turn, rng))
    votes = np.divide(votes, cast, out=np.zeros(len(votes)), where=cast > 0) * (-1 if inward else 1)
    ground |= sheets & (np.abs(votes) < _DECIDED)
    decided = ground | (np.abs(votes) >= _DECIDED)
    wanted = np.where(np.where(ground, risen, votes) > 0, 1, -1)
    wrong = decided[sets] & (turn != wanted[sets])
    return Orientation(*(np.unique(patches.numbers[sided[faces]]) for faces in (wrong, ~decided[sets])))


def _both(found: Orientation) -> tuple[Index, Index]:
    return found.wrong, found.undecided


def turned(faces: Index) -> Index:
    """The faces (f, 4) with the opposite orientation."""
    is_triangle = (faces[:, 2] == faces[:, 3])[:, None]
    return np.where(is_triangle, faces[:, [2, 1, 0, 0]], faces[:, ::-1])


def _sets(patches: Patches, sided: Index) -> tuple[Index, Index, NDArray[np.bool_]]:
    """For each face its set, and 1 or -1: whether it is turned as the first of the set; and for each set whether a part
    of its border is alone."""
    _, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[patches.faces[sided]]
    start, end = faces, np.roll(faces, -1, axis=1)
    face = np.broadcast_to(np.arange(len(sided))[:, None], faces.shape)
    real = start != end
    start, end, face = start[real], end[real], face[real]
    key = np.minimum(start, end) * (len(place) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    one, two = order[first[count == 2]], order[first[count == 2] + 1]
    agree = np.where((start[one] < end[one]) != (start[two] < end[two]), 1, -1)
    sets, turn = _joined(len(sided), face[one], face[two], agree)
    border = order[first[count == 1]]
    _, vertex = np.unique(place.reshape(-1), return_index=True)
    alone = border[free_edges(patches, vertex[np.stack([start[border], end[border]], axis=1)])]
    return sets, turn, np.bincount(sets[face[alone]], minlength=sets.max() + 1) > 0


def _joined(count: int, one: Index, two: Index, sign: Index) -> tuple[Index, Index]:
    """The set of each of ``count`` items, joined by pairs, and its sign relative to the first of the set."""
    parent, relative = list(range(count)), [1] * count

    def root(item: int) -> tuple[int, int]:
        path, product = [], 1
        while parent[item] != item:
            path.append(item)
            item = parent[item]
        for below in reversed(path):
            product *= relative[below]
            parent[below], relative[below] = item, product
        return item, product

    for a, b, s in zip(one.tolist(), two.tolist(), sign.tolist(), strict=True):
        (top, up), (other, over) = root(a), root(b)
        if top != other:  # the smaller number stays the first
            low, high = min(top, other), max(top, other)
            parent[high], relative[high] = low, up * over * s
    found = [root(k) for k in range(count)]
    _, sets = np.unique([top for top, _ in found], return_inverse=True)
    return sets.reshape(-1), np.array([s for _, s in found])


def _sheets(patches: Patches, faces: Index, sets: Index, turn: Index, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Whether each set is a sheet: its faces, turned alike, see little of each other's backs, or as much of fronts."""
    corners = patches.vertices[patches.faces[faces]]
    order = np.argsort(sets, kind="stable")
    found = []
    for members in np.split(order, np.cumsum(np.bincount(sets))[:-1]):
        chosen = rng.permutation(members)[:_SAMPLES]
        shares = []
        for face in chosen:
            a, b, c, d = (corners[members, k] - corners[face].mean(axis=0) for k in range(4))
            seen = turn[members] * (_solid_angles(a, b, c) + _solid_angles(a, c, d))
            shares.append(seen[members != face].sum() / (4 * np.pi))
        found.append(abs(np.mean(shares)) < _SHEET)
    return np.array(found)


def _solid_angles(a: Array, b: Array, c: Array) -> Array:
    """Signed solid angles of triangles (k, 3) seen from the origin [Oosterom 1983]."""
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=1)
    rest = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    result: Array = 2 * np.arctan2(volume, rest)
    return result


def _votes(
    patches: Patches, faces: Index, rays: Index, is_ground: NDArray[np.bool_], turn: Index, rng: np.random.Generator
) -> tuple[Array, Array]:
    """For each face the number of rays that find its front outside and its back inside, less that of those that find
    the opposite, and the number of rays that tell; both as the first face of the set is turned."""
    scene = RayScene(patches)
    row = np.repeat(np.arange(len(faces)), rays)
    corners = scene.local(patches.vertices)[patches.faces[faces]][row]
    # A point of one of the triangles of a face; halves of quadrilaterals need not have equal areas.
    second = (rng.random(len(row)) < 0.5) & (patches.faces[faces][row, 2] != patches.faces[faces][row, 3])
    a = corners[:, 0]
    b, c = (np.where(second[:, None], corners[:, k + 1], corners[:, k]) for k in (1, 2))
    u = rng.random((len(row), 2))
    u = np.where(u.sum(axis=1, keepdims=True) > 1, 1 - u, u)
    points = a + u[:, :1] * (b - a) + u[:, 1:] * (c - a)
    normals = patches.face_normals[faces][row]
    directions = rng.normal(size=points.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions *= np.where((directions * normals).sum(axis=1, keepdims=True) < 0, -1, 1)
    ground = np.zeros(len(patches.faces), bool)
    ground[faces[is_ground]] = True
    votes, told = np.zeros(len(faces)), np.zeros(len(faces))
    for side in (1, -1):
        count, met = _crossings(scene, points + 2 * STEP * side * normals, side * directions, ground)
        votes += np.bincount(row, np.where(met, 0, side * (1 - 2 * (count % 2))), len(faces))
        told += np.bincount(row, ~met, len(faces))
    return turn * votes, told


def _crossings(
    scene: RayScene, origins: Array, directions: Array, ground: NDArray[np.bool_]
) -> tuple[Index, NDArray[np.bool_]]:
    """Numbers of faces that rays (k, 3) cross, and whether they meet a face of the ``ground`` (f,), where they end."""
    import mitsuba as mi

    o, d = (
        mi.Vector3f(*(copied_to_device(mi.Float, np.ascontiguousarray(x, np.float32)) for x in v.T))
        for v in (origins, directions)
    )
    grounds = mi.Bool(ground)

    def cross(active: mi.Bool, o: mi.Point3f, count: mi.UInt32, met: mi.Bool) -> tuple[Any, ...]:
        hit = scene.hit(o, d, active)
        active &= hit.is_valid()
        met |= active & dr.gather(mi.Bool, grounds, scene.face_of(hit), active)
        count = count + dr.select(active, mi.UInt32(1), 0)
        o = dr.select(active, o + d * (hit.t + STEP), o)
        return active & ~met & (count < _CROSSINGS), o, count, met

    lanes = len(origins)
    start = dr.full(mi.Bool, True, lanes), mi.Point3f(o), dr.zeros(mi.UInt32, lanes), dr.zeros(mi.Bool, lanes)
    _, _, count, met = dr.while_loop(start, lambda active, *_: active, cross, label="crossings")
    return np.array(count).astype(np.int64), np.array(met)
