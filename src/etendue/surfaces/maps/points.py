"""Points of surfaces for integrals over them, and places in which each surface is searched alone."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device
from etendue.scene import RenderSpace

from ..patches import Patches
from .places import Located

if TYPE_CHECKING:
    import mitsuba as mi

Index = NDArray[np.int64]

#: Weights (4 points, 4 corners) of the centres of the four equal parts of a face.
_OF_TRIANGLES = np.array([[4, 1, 1, 0], [1, 4, 1, 0], [1, 1, 4, 0], [2, 2, 2, 0]]) / 6
_OF_QUADRILATERALS = np.array([[9, 3, 1, 3], [3, 9, 3, 1], [1, 3, 9, 3], [3, 1, 3, 9]]) / 16
#: Of points that become one: widths differ by at most this power of two, components of unit normals by this much.
_LIKE_WIDTHS, _LIKE_NORMALS = 1 / 4, 1 / 4
#: Multiplier of the hash of what merged points have in common.
_HASH = np.uint64(0x9E3779B97F4A7C15)
#: Greatest distance between points of one shape, and distance between the places of shapes, in radii of the scene.
OWN, _APART = 2.2, 5.0


def quadrature(patches: Patches, space: RenderSpace) -> tuple[Located, Index]:
    """Four points of each face of patches, whose power is their area in the scene's units, and the patch of each."""
    corners = patches.vertices[patches.faces]
    is_triangle = patches.faces[:, 2] == patches.faces[:, 3]
    weights = np.where(is_triangle[:, None, None], _OF_TRIANGLES, _OF_QUADRILATERALS)
    points = np.einsum("fpk,fkx->fpx", weights, corners)
    two = np.flatnonzero(patches.back >= 0)
    owner = np.concatenate([patches.front, patches.back[two]])
    points = np.concatenate([points, points[two]]).reshape(-1, 3)
    normals = np.concatenate([patches.face_normals, -patches.face_normals[two]])
    areas = np.repeat(np.concatenate([patches.face_areas, patches.face_areas[two]]) / 4, 4)
    owner, normals = np.repeat(owner, 4), np.repeat(normals, 4, axis=0)
    assert patches.shapes is not None
    power = np.repeat(areas[:, None], 3, axis=1)
    at = Located(
        space.from_scene(points), normals, patches.shapes[owner], power, np.zeros(len(owner), np.uint32), -normals
    )
    return at, owner


def merged(at: Located, keys: Index, widths: Array, edge: float) -> tuple[Located, Index]:
    """(fewer points, their indices): of the points (m,) of equal ``keys``, with similar normals and ``widths``, in the
    same cell of a grid whose edge is ``edge`` widths, one has the power of all. It is chosen at random, with a
    probability proportional to its power, so sums over points remain right in the mean.

    Where a mesh has many faces in the reach of a kernel, an integral over it visits no more points than on a coarse
    mesh, of which all points remain.
    """
    level = np.floor(np.log2(widths) / _LIKE_WIDTHS).astype(np.int64)
    cell = np.floor(at.position / (edge * np.exp2(level * _LIKE_WIDTHS))[:, None]).astype(np.int64)
    normal = np.rint(at.normal / _LIKE_NORMALS).astype(np.int64)
    mixed = np.zeros(len(at), np.uint64)
    for column in (keys, level, *normal.T, *cell.T):
        mixed = mixed * _HASH + column.astype(np.uint64)
    power = at.power.sum(axis=1)
    order = np.argsort(mixed, kind="stable")
    begins = np.flatnonzero(np.append(True, mixed[order][1:] != mixed[order][:-1]))
    summed = np.cumsum(power[order])
    before = np.append(0.0, summed)[begins]
    total = np.add.reduceat(power[order], begins)
    wanted = before + np.random.default_rng(0).random(len(begins)) * total
    last = np.append(begins[1:], len(order)) - 1
    chosen = order[np.clip(np.searchsorted(summed, wanted, side="right"), begins, last)]
    made = at.only(chosen)
    return replace(made, power=made.power * (total / power[chosen])[:, None]), chosen


class Apart:
    """Surfaces of different keys, each shifted to a place of its own. The distance between places exceeds the size of
    the scene, so that one search among the points of all surfaces finds only those of one.

    Coordinates are in radii of the scene and grow with the cube root of the number of keys: with a thousand of them,
    single precision rounds them to some millionths of the scene.
    """

    def __init__(self, patches: Patches, space: RenderSpace, keys: Index) -> None:
        import mitsuba as mi

        centre, unit = patches.sphere
        self._origin, self._radius, self._unit = space.from_scene(centre), unit, unit * space.scale
        self._keys = np.unique(keys)
        self.count = len(self._keys)
        row = math.ceil(self.count ** (1 / 3) - 1e-9)
        number = np.arange(self.count)
        grid = np.stack([number % row, number // row % row, number // row**2], axis=1)
        self._place = _APART * (grid - (row - 1) // 2)
        self._on_device = copied_to_device(mi.Float, self._place.astype(np.float32))

    def number(self, keys: Index) -> Index:
        """The numbers of keys, from 0 to ``count`` - 1."""
        found: Index = np.searchsorted(self._keys, keys)
        return found

    def length(self, lengths: Array) -> Array:
        """Lengths in the scene's units, in radii of the scene."""
        return lengths / self._radius

    def located(self, positions: Array, number: Index) -> Array:
        """Shifted positions of points (m, 3) of the render space."""
        found: Array = (positions - self._origin) / self._unit + self._place[number]
        return found

    def placed(self, p: mi.Point3f, number: mi.UInt32) -> mi.Point3f:
        """As :meth:`located`, on the device."""
        import mitsuba as mi

        local = (mi.Point3f(p) - mi.Point3f(*map(float, self._origin))) * float(1 / self._unit)
        return local + dr.gather(mi.Point3f, self._on_device, number)
