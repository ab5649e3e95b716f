"""Smallest spheres around points and around spheres."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from etendue.core import Array

#: Relative tolerance of the radius, for points on a sphere: rounding.
_TOLERANCE = 1e-10
#: Largest number of corrections of a sphere; ten are usual.
_MOST = 1000


def bounding_sphere(points: Array) -> tuple[Array, float]:
    """Centre and radius of the smallest sphere around points (n, 3).

    Two to four points on the sphere, the support, determine it. The farthest point outside the current sphere is added
    to the support until no point is outside [Gaertner 1999].
    """
    centre, radius = points.mean(axis=0), 0.0
    support = points[:0]
    for _ in range(_MOST):
        square = ((points - centre) ** 2).sum(axis=1)
        farthest = points[np.argmax(square)]
        outside = float(np.sqrt(square.max()))
        if len(support) and outside <= radius * (1 + _TOLERANCE):
            break
        support, centre, radius = _smallest(support, farthest)
    return centre, float(np.sqrt(((points - centre) ** 2).sum(axis=1).max()))


def joint_sphere(centre: Array, radius: float, other: Array, other_radius: float) -> tuple[Array, float]:
    """Centre and radius of the smallest sphere around two spheres."""
    way = other - centre
    distance = float(np.linalg.norm(way))
    if distance + other_radius <= radius:
        return centre, radius
    if distance + radius <= other_radius:
        return other, other_radius
    joint = (distance + radius + other_radius) / 2
    return centre + way * (joint - radius) / distance, joint


def _smallest(support: Array, new: Array) -> tuple[Array, Array, float]:
    """The smallest sphere around at most four points that has a new point on it: its support, centre and radius."""
    everything = np.vstack([support, new])
    best: tuple[Array, Array, float] = np.array([new]), new, 0.0
    if len(support) == 0:
        return best
    found = np.inf
    for size in range(1, min(len(support), 3) + 1):
        for rows in combinations(range(len(support)), size):
            chosen = np.vstack([support[list(rows)], new])
            sphere = _through(chosen)
            if sphere is None or sphere[1] >= found:
                continue
            centre, radius = sphere
            if (((everything - centre) ** 2).sum(axis=1) <= (radius * (1 + _TOLERANCE)) ** 2).all():
                best, found = (chosen, centre, radius), radius
    if not np.isfinite(found):  # by rounding no sphere holds all of them: take one that does
        centre = everything.mean(axis=0)
        return everything[-4:], centre, float(np.linalg.norm(everything - centre, axis=1).max())
    return best


def _through(points: Array) -> tuple[Array, float] | None:
    """The smallest sphere through two to four points; ``None`` for three on a line or four in a plane."""
    ways = points[1:] - points[0]
    squares = (ways**2).sum(axis=1)
    gram = 2 * ways @ ways.T
    if abs(np.linalg.det(gram)) <= 1e-12 * np.prod(2 * squares):
        return None
    centre = np.linalg.solve(gram, squares) @ ways
    return points[0] + centre, float(np.linalg.norm(centre))
