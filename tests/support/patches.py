"""Surfaces as patches, and form factors in closed form [Howell's catalogue C-11, C-14, C-41]."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from etendue.radiosity import FormFactors, Patches, box, joined

BOXES = (
    ((0.12, 0.15, 0.1), (0.42, 0.4, 0.55)),
    ((0.6, 0.1, 0.2), (0.85, 0.5, 0.45)),
    ((0.15, 0.6, 0.35), (0.45, 0.85, 0.9)),
    ((0.58, 0.62, 0.08), (0.88, 0.9, 0.62)),
)


def cube(n, **properties):
    """The inside of the unit cube, n x n quadrilaterals a wall."""
    return Patches(*box((0, 0, 0), (1, 1, 1), n, inward=True), **properties)


def room(n, **properties):
    """The same with four boxes floating in it."""
    boxes = [box(low, high, np.maximum(np.rint((np.array(high) - low) * n), 1).astype(int)) for low, high in BOXES]
    return Patches(*joined(box((0, 0, 0), (1, 1, 1), n, inward=True), *boxes), **properties)


def square(origin, a, b):
    """One quadrilateral with its front towards a x b."""
    origin, a, b = (np.asarray(x, dtype=float) for x in (origin, a, b))
    return np.array([origin, origin + a, origin + a + b, origin + b]), np.array([[0, 1, 2, 3]])


def parallel_squares():
    """Patches 0 and 1: unit squares at distance 1, and F_01."""
    return joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0))), opposite(1, 1)


def perpendicular_squares():
    """Unit squares with a common edge."""
    return joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 0), (0, 1, 0), (0, 0, 1))), adjacent(1, 1)


def squares(*areas):
    """Flat squares of these areas, side by side: only their areas matter beside given factors."""
    corners, faces = [], []
    for k, area in enumerate(areas):
        side, x = np.sqrt(area), 10.0 * k
        corners += [(x, 0, 0), (x + side, 0, 0), (x + side, side, 0), (x, side, 0)]
        faces.append([4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 3])
    return Patches(np.array(corners, float), faces)


def factors_of(patches, matrix):
    """Given form factors; what is missing in their rows is the sky."""
    matrix = np.asarray(matrix, float)
    f = csr_array(matrix)
    sky = np.clip(1 - matrix.sum(axis=1), 0, 1)
    return FormFactors(f, f * 0, sky, patches.areas, np.ones(len(patches)))


def discs(sides=256):
    """Coaxial discs of radius 1 at distance 1: patches 0 and 1 as fans, polygons of the area of the circle."""
    angle = 2 * np.pi * np.arange(sides) / sides
    radius = np.sqrt(np.pi / (sides / 2 * np.sin(2 * np.pi / sides)))
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(sides)], axis=1)
    k = np.arange(sides)
    fan = np.stack([np.zeros_like(k), k + 1, (k + 1) % sides + 1], axis=1)
    low = np.concatenate([np.zeros((1, 3)), ring])
    mesh = joined((low, fan), (low + np.array([0, 0, 1]), fan[:, ::-1]))
    return mesh, (3 - np.sqrt(5)) / 2


def opposite(x, y):
    """Equal rectangles facing each other, sides in units of the distance."""
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    logarithm = 0.5 * np.log(p**2 * q**2 / (1 + x * x + y * y))
    arcs = x * q * np.arctan(x / q) + y * p * np.arctan(y / p) - x * np.arctan(x) - y * np.arctan(y)
    return 2 / (np.pi * x * y) * (logarithm + arcs)


def adjacent(h, w):
    """Rectangles at a right angle with a common edge: from that of width w to that of height h, in lengths of the
    edge."""
    s = h * h + w * w
    logarithm = np.log((1 + w * w) * (1 + h * h) / (1 + s))
    logarithm += w * w * np.log(w * w * (1 + s) / ((1 + w * w) * s)) + h * h * np.log(
        h * h * (1 + s) / ((1 + h * h) * s)
    )
    arcs = w * np.arctan(1 / w) + h * np.arctan(1 / h) - np.sqrt(s) * np.arctan(1 / np.sqrt(s))
    return (arcs + logarithm / 4) / (np.pi * w)
