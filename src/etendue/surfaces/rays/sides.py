"""Sides of triangles that belong to patches and emit rays; directions around their normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from ..faces import triangles
from ..patches import Patches

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Sides:
    """Sides of triangles from which rays start, grouped by patch."""

    corners: Array  #: (s, 3, 3), in unit coordinates
    normals: Array  #: (s, 3), into the half-space of the side
    patch: Index  #: (s,) ascending
    face: Index  #: (s,)
    edges: Array  #: (s + 1,) cumulated areas

    @classmethod
    def of(cls, patches: Patches) -> Sides:
        """All sides that belong to a patch."""
        vertices, faces = patches.coincident.apart(patches)
        corner, face = triangles(faces)
        patch = np.concatenate([patches.front[face], patches.back[face]])
        kept = np.flatnonzero(patch >= 0)
        kept = kept[np.argsort(patch[kept], kind="stable")]
        row = kept % len(face)
        centre, radius = patches.sphere
        corners = (vertices[corner[row]] - centre) / radius
        normals = patches.face_normals[face[row]] * np.where(kept < len(face), 1, -1)[:, None]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        return cls(corners, normals, patch[kept], face[row], np.concatenate([[0], np.cumsum(areas)]))

    @property
    def areas(self) -> Array:
        """(s,) in unit coordinates."""
        return np.diff(self.edges)

    def emitting(self, power: Array) -> Sides:
        """The sides of patches with ``power`` (n,) above 0; their ``edges`` are cumulated powers."""
        whole = np.bincount(self.patch, self.areas, len(power))
        by_side = power[self.patch] / whole[self.patch] * self.areas
        lit = np.flatnonzero(by_side)
        edges = np.concatenate([[0.0], np.cumsum(by_side[lit])])
        return Sides(self.corners[lit], self.normals[lit], self.patch[lit], self.face[lit], edges)

    def pick_of(self, patch: Index, u: Array) -> tuple[Index, Array]:
        """Sides of given patches, sampled by area from numbers in [0, 1), and the remainders of the numbers, in [0, 1)
        again."""
        first = self.edges[np.searchsorted(self.patch, patch, side="left")]
        last = self.edges[np.searchsorted(self.patch, patch, side="right")]
        place = first + u * (last - first)
        side = np.clip(np.searchsorted(self.edges, place, side="right") - 1, 0, len(self.patch) - 1)
        # Rounding must not select a neighbour.
        wrong = self.patch[side] != patch
        side[wrong] = np.searchsorted(self.patch, patch[wrong], side="right") - 1
        within = (place - self.edges[side]) / (self.edges[side + 1] - self.edges[side])
        return side, np.clip(within, 0, np.nextafter(1, 0))

    def points(self, side: Index, u: Array) -> Array:
        """Uniform points (k, 3) of sides, from (k, 2) numbers."""
        a, b, c = (self.corners[side, i] for i in range(3))
        root = np.sqrt(u[:, :1])
        return (1 - root) * a + root * (1 - u[:, 1:]) * b + root * u[:, 1:] * c


def cosine_law(u: Array) -> Array:
    """Directions (k, 3) of cosine density around the third axis, from (k, 2) numbers."""
    r, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[:, 0])], axis=1)


def around(normals: Array, ways: Array) -> Array:
    """Directions in space from ``ways`` (k, 3), given in frames whose third axes are ``normals``."""
    a, b = across(normals)
    return ways[:, :1] * a + ways[:, 1:2] * b + ways[:, 2:] * normals


def across(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (n, 3) that make a right-handed frame with each unit vector [Duff 2017]."""
    x, y, z = normals.T
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1),
        np.stack([b, sign + y * y * a, -y], axis=1),
    )
