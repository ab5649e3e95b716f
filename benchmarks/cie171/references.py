"""What is true in the test cases: configuration factors, Fresnel's equations and integrals over skies, by NumPy alone.

Nothing here uses étendue. Integrals are Gauss's rule on panels, split where the integrand has an edge: at the horizon,
at the sun, at masks. Directions are (x, y, z up); an illuminance is a share of that of the whole sky on the horizontal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: a, b, c, d, e of the CIE general skies 1 to 15 [CIE S 011/E:2003, table 1].
SKIES: tuple[tuple[float, float, float, float, float], ...] = (
    (4.0, -0.70, 0.0, -1.0, 0.00),
    (4.0, -0.70, 2.0, -1.5, 0.15),
    (1.1, -0.80, 0.0, -1.0, 0.00),
    (1.1, -0.80, 2.0, -1.5, 0.15),
    (0.0, -1.00, 0.0, -1.0, 0.00),
    (0.0, -1.00, 2.0, -1.5, 0.15),
    (0.0, -1.00, 5.0, -2.5, 0.30),
    (0.0, -1.00, 10.0, -3.0, 0.45),
    (-1.0, -0.55, 2.0, -1.5, 0.15),
    (-1.0, -0.55, 5.0, -2.5, 0.30),
    (-1.0, -0.55, 10.0, -3.0, 0.45),
    (-1.0, -0.32, 10.0, -3.0, 0.45),
    (-1.0, -0.32, 16.0, -3.0, 0.30),
    (-1.0, -0.15, 16.0, -3.0, 0.30),
    (-1.0, -0.15, 24.0, -2.8, 0.15),
)
#: Of the glass.
INDEX = 1.52


@dataclass(frozen=True)
class GeneralSky:
    """A CIE general sky [CIE S 011/E:2003, eqs. 1 to 6] whose illuminance of the horizontal is 1. ``sun``: unit vector
    towards the sun."""

    kind: int
    sun: tuple[float, float, float]

    def luminance(self, d: Array) -> Array:
        """(...) of unit vectors (..., 3) above the horizon."""
        return self._relative(d) / self._illuminance

    def vertical(self, normal: ArrayLike) -> float:
        """Illuminance by the whole sky of a vertical plane that faces in a horizontal direction."""
        return self._integral(np.asarray(normal, float)) / self._illuminance

    def _relative(self, d: Array) -> Array:
        a, b, c, dd, e = SKIES[self.kind - 1]
        chi = np.arccos(np.clip(d @ np.asarray(self.sun), -1.0, 1.0))
        gradation = 1.0 + a * np.exp(b / np.maximum(d[..., 2], 1e-12))
        scattered = 1.0 + c * (np.exp(dd * chi) - np.exp(0.5 * dd * np.pi)) + e * np.cos(chi) ** 2
        return gradation * scattered

    @cached_property
    def _illuminance(self) -> float:
        return self._integral(np.array([0.0, 0.0, 1.0]))

    def _integral(self, normal: Array) -> float:
        """Of luminance times the positive cosine; azimuths are split at the sun and where the cosine is 0."""
        turn = np.arctan2(self.sun[1], self.sun[0]) % np.pi
        side = (np.arctan2(normal[1], normal[0]) + 0.5 * np.pi) % np.pi
        cuts = sorted({0.0, turn, side, np.pi, turn + np.pi, side + np.pi, 2.0 * np.pi})
        azimuth, across = gauss(cuts, 40)
        zenith, along = gauss([0.0, np.arccos(self.sun[2]), 1.3, 0.5 * np.pi], 40)
        sin, cos = np.sin(zenith)[:, None], np.cos(zenith)[:, None]
        d = np.stack(np.broadcast_arrays(sin * np.cos(azimuth), sin * np.sin(azimuth), cos), axis=-1)
        weight = (along * np.sin(zenith))[:, None] * across
        return float((self._relative(d) * np.maximum(d @ normal, 0.0) * weight).sum())


def gauss(cuts: Iterable[float], count: int) -> tuple[Array, Array]:
    """Points and weights of Gauss's rule with ``count`` points between each two of the ``cuts``."""
    x, w = np.polynomial.legendre.leggauss(count)
    edges = sorted(set(map(float, cuts)))
    parts = [(low + 0.5 * (high - low) * (x + 1.0), 0.5 * (high - low) * w) for low, high in pairwise(edges)]
    return np.concatenate([p for p, _ in parts]), np.concatenate([p for _, p in parts])


def configuration_factor(points: ArrayLike, normals: ArrayLike, polygon: ArrayLike) -> Array:
    """(k,) configuration factors from planes at points (k, 3) with normals to a polygon (m, 3) in front of all of
    them, by Lambert's formula: F = |sum over edges of the angle that the edge subtends, times the cosine between the
    normal and that of the plane through edge and point| / 2 pi."""
    p, n = np.broadcast_arrays(np.atleast_2d(np.asarray(points, float)), np.atleast_2d(np.asarray(normals, float)))
    corners = np.asarray(polygon, float)[None] - p[:, None]
    following = np.roll(corners, -1, axis=1)
    cross = np.cross(corners, following)
    sine = np.linalg.norm(cross, axis=-1)
    angle = np.arctan2(sine, (corners * following).sum(-1))
    edges = angle * (cross * n[:, None]).sum(-1) / np.maximum(sine, 1e-300)
    return np.abs(edges.sum(axis=1)) / (2.0 * np.pi)


def reflectance(cosine: ArrayLike) -> Array:
    """Of an interface of the glass for light without polarisation [Fresnel]."""
    c = np.asarray(cosine, float)
    inside = np.sqrt(1.0 - (1.0 - c**2) / INDEX**2)
    s = (c - INDEX * inside) / (c + INDEX * inside)
    p = (INDEX * c - inside) / (INDEX * c + inside)
    return 0.5 * (s**2 + p**2)


def twice_refracted(cosine: ArrayLike) -> Array:
    """The light that passes both interfaces of a pane without a reflection in between: (1 - R)^2."""
    return (1.0 - reflectance(cosine)) ** 2


def pane(cosine: ArrayLike) -> Array:
    """All light that passes a clear pane: (1 - R)^2 (1 + R^2 + R^4 + ...) = (1 - R) / (1 + R)."""
    r = reflectance(cosine)
    return (1.0 - r) / (1.0 + r)


@dataclass(frozen=True)
class Opening:
    """A rectangle with sides along two axes: ``low`` and ``high`` are its corners, equal along its normal ``axis``."""

    axis: int
    low: tuple[float, float, float]
    high: tuple[float, float, float]


#: Luminance of what is seen in directions (k, 3) from a point.
Seen = Callable[[Array], Array]


def illuminance(
    point: ArrayLike,
    normal: ArrayLike,
    opening: Opening,
    seen: Seen,
    cuts: dict[int, Sequence[float]],
    glazed: bool = False,
    panels: int = 24,
    count: int = 6,
) -> float:
    """At a point, by what is seen through an opening. ``cuts``: where the integrand has an edge or a peak, by axis."""
    p, n = np.asarray(point, float), np.asarray(normal, float)
    across = [k for k in range(3) if k != opening.axis]
    nodes = []
    for k in across:
        low, high = opening.low[k], opening.high[k]
        inner = [c for c in cuts.get(k, ()) if low < c < high]
        nodes.append(gauss([*np.linspace(low, high, panels + 1), *inner], count))
    (u, wu), (v, wv) = nodes
    q = np.empty((len(u), len(v), 3))
    q[..., opening.axis] = opening.low[opening.axis]
    q[..., across[0]], q[..., across[1]] = u[:, None], v[None, :]
    q = (q - p).reshape(-1, 3)
    square = (q**2).sum(-1)
    d = q / np.sqrt(square)[:, None]
    facing = np.abs(d[:, opening.axis])
    weight = np.outer(wu, wv).ravel() * np.maximum(d @ n, 0.0) * facing / square
    if glazed:
        weight = weight * pane(facing)
    return float(seen(d) @ weight)


def peak(point: ArrayLike, opening: Opening, sun: ArrayLike) -> dict[int, list[float]]:
    """Where the opening is met by the line from the point towards the sun."""
    p, s = np.asarray(point, float), np.asarray(sun, float)
    far = (opening.low[opening.axis] - p[opening.axis]) / s[opening.axis] if s[opening.axis] else -1.0
    return {k: [float(p[k] + far * s[k])] for k in range(3) if far > 0.0}


@dataclass(frozen=True)
class Outside:
    """Sky, and a ground of uniform luminance below the horizon: its reflectance times the illuminance of the sky over
    pi."""

    sky: GeneralSky
    ground: float = 0.0

    def luminance(self, d: Array) -> Array:
        """(...) of unit vectors (..., 3)."""
        return np.where(d[..., 2] > 0.0, self.sky.luminance(d), self.ground / np.pi)
