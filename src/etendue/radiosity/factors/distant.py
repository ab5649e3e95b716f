"""Form factors of flat polygons that see all of each other from a distance, by Gauss's rule on both areas.

The smooth kernel of distant pairs needs few points, none of which costs a logarithm. The loops are compiled for the CPU
by Numba.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from etendue.core import Array

#: Points of the rules along each side of a quadrilateral, and where those of each begin.
_ORDERS = (2, 3, 4)
_STARTS = np.cumsum([0, *(n * n for n in _ORDERS)])
#: The error of the rule of n x n points at d diameters is at most so much times d^(-2 n), in units of A_p A_q / (pi
#: d^2): the largest was .3, .011 and .0007 of 50,000 random pairs of triangles and quadrilaterals.
_ERRORS = (0.4, 0.015, 0.002)


def nodes_of(sides: Array) -> Array:
    """Points and weights, which sum to the area, of all rules on polygons (s, 4, 3): (s, 29, 4)."""
    from scipy.special import roots_jacobi

    a, b, c, d = (sides[:, None, k] for k in range(4))
    is_triangle = (c == d).all(axis=2)
    found = []
    for n in _ORDERS:
        x, w = np.polynomial.legendre.leggauss(n)
        # The map of a square to a triangle shrinks with 1 - v, which is a weight of the rule.
        y, of_y = roots_jacobi(n, 1.0, 0.0)
        u, v = (np.tile((1 + x) / 2, n)[:, None], np.where(is_triangle, *(np.repeat((1 + z) / 2, n) for z in (y, x))))
        weight = np.where(is_triangle, *(np.outer(z, w).ravel() / 4 for z in (of_y / (1 - y), w)))
        v = v[..., None]
        point = (1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d
        along_u, along_v = (1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)
        weight = weight * np.linalg.norm(np.cross(along_u, along_v), axis=-1)
        found.append(np.concatenate([point, weight[..., None]], axis=-1))
    return np.ascontiguousarray(np.concatenate(found, axis=1))


def least_distances(error: float) -> Array:
    """(3,) the squares of the distances of centres, in squares of the larger diameter, from which each rule has at most
    this error."""
    return np.array([max((c / error) ** (1 / n), 1.5**2) for c, n in zip(_ERRORS, _ORDERS, strict=True)])


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def of_nodes(x: Array, of_x: Array, y: Array, of_y: Array, rule: int) -> float:
    """A F of two polygons by a rule, from their points (29, 4) and planes."""
    total, start, end = 0.0, _STARTS[rule], _STARTS[rule + 1]
    for i in range(start, end):
        for j in range(start, end):
            rx, ry, rz = y[j, 0] - x[i, 0], y[j, 1] - x[i, 1], y[j, 2] - x[i, 2]
            square = rx * rx + ry * ry + rz * rz
            cosines = (of_x[0] * rx + of_x[1] * ry + of_x[2] * rz) * (of_y[0] * rx + of_y[1] * ry + of_y[2] * rz)
            total -= x[i, 3] * y[j, 3] * cosines / (square * square)
    return max(total / math.pi, 0.0)
