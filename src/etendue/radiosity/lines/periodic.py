"""Bundles of parallel lines through a domain that repeats without end along x and y.

Seen along a line, the repetitions of the domain are a lattice of parallelograms, and lines at the same place in two of
them are the same. The lines of a bundle are the points of a finer lattice, which contains that of the repetitions: each
crosses the horizontal plane of one period at one point. Every face is then rasterised once, wherever its image lies,
and lines in other repetitions are brought back, without loss and without copies of faces. Hits of a line are sorted by
their height, which is the same in all repetitions.

Lines have the uniform density of integral geometry if a bundle has as many as its direction is steep: the cosine of
its angle to z times those of a vertical bundle. This is no whole number, and not each whole number has a good lattice:
one of two numbers close to it is taken at random, so that the mean is right.
"""

from __future__ import annotations

from itertools import product
from math import gcd

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.surfaces import LEAST_SLOPE, Patches

from ..errors import RadiosityError
from .generators import TURN, Bundles, direction

#: Changes of the steps of a lattice, (k, 2, 2), that are tried for a number of lines.
_TRIED = np.array(list(product((-1, 0, 1), repeat=4)), np.float64).reshape(-1, 2, 2)
#: A coordinate of a point is used in steps of this for the shift of a grid, the rest for the choice of its lattice.
_STEPS = 4096


class PeriodicBundles(Bundles):
    """Parallel lines of uniform direction through a periodic domain.

    lines: of a vertical bundle through one period; of a domain that repeats in one direction only, through its part
        between the ends of the mesh. Lines that would be flatter than ``LEAST_SLOPE`` have this slope.

    Raises :class:`RadiosityError` for less than one line.
    """

    name = "periodic"

    def __init__(self, patches: Patches, lines: float = 4096) -> None:
        assert patches.period is not None
        super().__init__(patches, 1.0)
        if not np.isfinite(lines) or lines < 1:
            raise RadiosityError(f"a bundle has one line at least, not {lines!r}")
        self.period, self._count = np.array(patches.period), float(lines)
        low, high = patches.bounds
        #: Extent of the domain, and half its height in radii.
        self.sides = np.where(self.period > 0, self.period, np.maximum((high - low)[:2], 1e-3 * self.radius))
        self._half_height = max(float(high[2] - low[2]) / 2 / self.radius, 1e-9)
        self.spacing = float(np.sqrt(self.sides.prod() / lines))

    @property
    def lines_per_point(self) -> float:
        """See :class:`LineGenerator`: lines through one period, in the mean over directions."""
        return self._count / 2

    def expected(self, areas: Array, points: int) -> Array:
        """See :class:`LineGenerator`: half of the area is seen in the mean over directions."""
        return points * areas / (2 * self.spacing**2)

    def frames(self, u: Array) -> Array:
        """See :class:`Bundles`, and :meth:`frames_along`."""
        return self.frames_along(direction(u), u[:, 2] * _STEPS % 1)

    def frames_along(self, way: Array, choice: Array | float = 0.5) -> Array:
        """(n, 4, 3) frames of upward directions (n, 3); the rows are the axes of the grid, sheared along the direction,
        the height in units of half that of the domain, and the direction. ``choice``: random numbers (n,)."""
        slope = np.maximum(way[:, 2], LEAST_SLOPE)
        lattices = self._lattices(self._count * slope, np.broadcast_to(choice, slope.shape))
        frames = np.zeros((len(way), 4, 3))
        frames[:, :2, :2] = lattices / self.sides * self.spacing
        frames[:, :2, 2] = -(frames[:, :2, :2] @ (way[:, :2] / slope[:, None])[:, :, None])[:, :, 0]
        frames[:, 2, 2] = 1 / self._half_height
        frames[:, 3] = way
        return frames

    def directions(self, frames: Array) -> Array:
        """See :class:`Bundles`."""
        return frames[:, 3]

    def wraps(self, frames: Array) -> NDArray[np.int64]:
        """See :class:`Bundles`."""
        steps = np.rint(frames[:, :2, :2] * self.period / self.spacing).astype(np.int64)
        return np.array([_wrap(*step[:, 0].tolist(), *step[:, 1].tolist()) for step in steps]).reshape(-1, 3)

    def _lattices(self, lines: Array, choice: Array) -> Array:
        """(n, 2, 2) columns and rows along the sides of the domain: about equally spaced, and whole numbers along
        periods. Their determinants, the numbers of lines, have the means ``lines`` (n,) over the ``choice``."""
        periodic, count = self.period > 0, len(lines)
        steps = self.sides * np.sqrt(lines / self.sides.prod())[:, None]
        found = np.zeros((count, 2, 2))
        if not periodic.all():  # rows repeat, columns go on
            along = int(np.argmax(periodic))
            rows = np.maximum(np.rint(steps[:, along]), 1.0)
            found[:, 1, along], found[:, 0, 1 - along] = rows, lines / rows * (1 if along else -1)
            return found
        (x, y), cosine, sine = steps.T, np.cos(TURN), np.sin(TURN)
        turned = np.rint(np.array([[cosine * x, sine * y], [-sine * x, cosine * y]]).transpose(2, 0, 1))
        whole = np.ceil(steps)[:, None, :, None] * np.eye(2)
        tried = np.concatenate([np.zeros((count, 1, 2, 2)), whole, turned[:, None] + _TRIED], axis=1)
        counts = tried[..., 0, 0] * tried[..., 1, 1] - tried[..., 0, 1] * tried[..., 1, 0]
        wanted = lines[:, None]
        more = np.where(counts >= wanted, counts, np.inf).min(axis=1)
        less = np.where((counts >= 0) & (counts <= wanted), counts, -np.inf).max(axis=1)
        taken = np.where(choice * (more - less) < lines - less, more, less)
        # The first one with this number: without lines, zeros.
        return tried[np.arange(count), np.argmax(counts == taken[:, None], axis=1)]


def _wrap(a: int, b: int, c: int, d: int) -> tuple[int, int, int]:
    """Columns and rows after which a grid repeats whose periods are (a, b) and (c, d) columns and rows, and the columns
    by which it is shifted after its rows; zeros for a direction without. Columns and rows are Hermite's normal form."""
    if a == b == 0 or c == d == 0:
        return 0, b or d, 0
    (g, x, y), size = _bezout(b, d), abs(a * d - b * c)
    columns = size // g
    return columns, g, (x * a + y * c) % columns


def _bezout(a: int, b: int) -> tuple[int, int, int]:
    """The greatest common divisor g of two numbers, and x and y with x a + y b = g."""
    g = gcd(a, b)
    if b == 0:
        return g, (1 if a > 0 else -1), 0
    x = pow(a // g, -1, abs(b) // g)
    return g, x, (g - x * a) // b
