r"""A density of lines by the places that they pass: lines of given directions through cells of a box.

With a density rho of points in space, a line of direction w is sampled through a point of density rho. Its density, per
area perpendicular to w, is that of all points on it,

.. math:: p(x | w) = \int \rho(x + t w) \, dt .

rho is constant in each cell of a grid, so that the integral is a sum over the cells that the line crosses. A hole
through which lines pass, such as a window, fits into one density for all directions; compare [Rath 2023].

:func:`fit_lines` finds the density that makes given lines most likely, by expectation maximisation [Dempster 1977]:
each line belongs to the cells that it crosses, in proportion to their contributions to its density.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device, in_steps, on_device

#: Cells of the final grid and its iterations at most, and of those that look for its box.
_FINE, _ITERATIONS, _COARSE, _COARSE_ITERATIONS = 1 << 15, 16, 1 << 12, 4
#: Least number of lines, and the number of those that look for the box.
LEAST_LINES, _LOOKING = 1 << 9, 1 << 10
#: Shares of the mass that the next box may leave out at either end of an axis.
_TAILS = (0.002, 0.02, 0.1)
#: Margin around a box, relative to its longest side, and share of the mass that is spread over all cells.
_EDGE, _ANYWHERE = 1e-3, 0.02
#: Least component of a direction by which lengths are divided.
_TINY = 1e-12


@dataclass(frozen=True)
class LineCells:
    """A density of points on the host: ``mass`` (nx, ny, nz) of the cells between two corners, with sum 1."""

    lower: Array
    upper: Array
    mass: Array


class LineDensity:
    """A :class:`LineCells` on the device."""

    def __init__(self, cells: LineCells) -> None:
        shape = np.array(cells.mass.shape)
        size = (cells.upper - cells.lower) / shape
        self._counts, self._lower, self._size = mi.Vector3u(0), mi.Point3f(0), mi.Vector3f(0)
        for axis in range(3):
            self._counts[axis] = dr.opaque(mi.UInt32, int(shape[axis]))
            self._lower[axis] = dr.opaque(mi.Float, float(cells.lower[axis]))
            self._size[axis] = dr.opaque(mi.Float, float(size[axis]))
        mass = in_steps(cells.mass.ravel(), 23)  # as random numbers: cells are sampled as often as they count
        self._rho = copied_to_device(mi.Float, (mass / size.prod()).astype(np.float32))
        self._cdf = mi.DiscreteDistribution(on_device(mi.Float, mass))

    def sample(self, pick: mi.Float, u: mi.Point3f, active: mi.Bool) -> mi.Point3f:
        """A point: ``pick`` chooses the cell."""
        index = self._cdf.sample(pick, active)
        row = index // self._counts.z
        x = row // self._counts.y
        cell = mi.Point3f(x, row - x * self._counts.y, index - row * self._counts.z)
        return self._lower + (cell + u) * self._size

    def along(self, o: mi.Point3f, d: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """The density of the lines through ``o`` of the unit directions ``d``, both ways."""
        inverse = dr.rcp(dr.select(dr.abs(d) < _TINY, _TINY, d))
        ends = self._lower + self._size * mi.Vector3f(self._counts)
        first, second = (self._lower - o) * inverse, (ends - o) * inverse
        start, stop = dr.max(dr.minimum(first, second)), dr.min(dr.maximum(first, second))
        place = (o + d * start - self._lower) / self._size
        last = mi.Vector3i(self._counts) - 1
        cell = dr.clip(mi.Vector3i(dr.floor(place)), 0, last)
        ahead = inverse > 0.0
        planes = mi.Vector3f(cell) + dr.select(ahead, mi.Vector3f(1.0), mi.Vector3f(0.0))
        to_next = (self._lower + planes * self._size - o) * inverse
        apart = dr.abs(self._size * inverse)
        step = dr.select(ahead, mi.Vector3i(1), mi.Vector3i(-1))

        def cross(
            active: mi.Bool, t: mi.Float, cell: mi.Vector3i, to_next: mi.Vector3f, found: mi.Float
        ) -> tuple[mi.Bool, mi.Float, mi.Vector3i, mi.Vector3f, mi.Float]:
            end = dr.minimum(dr.min(to_next), stop)
            index = mi.UInt32((cell.x * mi.Int32(self._counts.y) + cell.y) * mi.Int32(self._counts.z) + cell.z)
            found = found + dr.gather(mi.Float, self._rho, index, active) * dr.maximum(end - t, 0.0)
            x = (to_next.x <= to_next.y) & (to_next.x <= to_next.z)
            y = ~x & (to_next.y <= to_next.z)
            moved = mi.Vector3i(dr.select(x, step.x, 0), dr.select(y, step.y, 0), dr.select(x | y, 0, step.z))
            further = mi.Vector3f(
                dr.select(x, apart.x, 0.0), dr.select(y, apart.y, 0.0), dr.select(x | y, 0.0, apart.z)
            )
            cell = cell + moved
            active = active & (end < stop) & dr.all((cell >= 0) & (cell <= last))
            return active, end, cell, to_next + further, found

        state = active & (stop > start), start, cell, to_next, mi.Float(0.0)
        return dr.while_loop(state, lambda active, *_: active, cross, label="line density")[4]


def fit_lines(
    o: Array, d: Array, weight: Array, lower: Array, upper: Array, *, share: float, even: float
) -> tuple[LineCells, float] | None:
    """The density in the box from ``lower`` to ``upper`` that makes lines most likely, in a mixture of which it has the
    ``share`` and a density ``even`` of all lines the rest. Lines: origins and unit directions (n, 3), weights (n,).

    Returns it and the factor by which the lines are likelier than by ``even`` alone, a geometric mean; each half of
    them is judged by a fit to the other half. None if they are too few."""
    edge = _EDGE * np.max(np.subtract(upper, lower))  # a box may be flat, and have lines in its faces
    if len(o) < LEAST_LINES or not weight.sum() > 0.0 or not edge > 0.0:
        return None
    box = np.array([lower - edge, upper + edge], np.float64)
    few = slice(None, None, max(1, len(o) // _LOOKING))

    def tried(box: Array, most: int, lines: slice, cells: int) -> tuple[_Crossed, int, float]:
        crossed = _Crossed.by(o[lines], d[lines], box, cells)
        return crossed, *crossed.halves(weight[lines], most, share, even)

    crossed, count, score = tried(box, _COARSE_ITERATIONS, few, _COARSE)
    while True:
        mass = crossed.fitted(weight[few], max(count, 1))
        boxes = [_closer(box, mass, tail) for tail in _TAILS]
        trials = [tried(closer, _COARSE_ITERATIONS, few, _COARSE) for closer in boxes]
        best = max(range(len(boxes)), key=lambda i: trials[i][2])
        if trials[best][2] <= score:
            break
        box, (crossed, count, score) = boxes[best], trials[best]
    crossed, count, score = tried(box, _ITERATIONS, slice(None), _FINE)
    mass = crossed.fitted(weight, count)
    return LineCells(box[0], box[1], (1.0 - _ANYWHERE) * mass + _ANYWHERE / mass.size), float(np.exp(score))


def _shape(box: Array, cells: int) -> tuple[int, int, int]:
    """Cells of a box, about cubes."""
    extent = box[1] - box[0]
    shape = np.maximum(np.floor(extent * (cells / extent.prod()) ** (1.0 / 3.0)), 1.0)
    while shape.prod() > cells:
        shape[shape.argmax()] -= 1.0
    x, y, z = shape.astype(int)
    return int(x), int(y), int(z)


def _closer(box: Array, mass: Array, tail: float) -> Array:
    """The box without a share ``tail`` of the mass at either end of each axis, with a cell around it."""
    result = box.copy()
    for axis in range(3):
        count = mass.shape[axis]
        marginal = mass.sum(axis=tuple(a for a in range(3) if a != axis))
        below = np.cumsum(marginal)
        first = int(np.searchsorted(below, tail))
        last = min(int(np.searchsorted(below, 1.0 - tail)), count - 1)
        size = (box[1, axis] - box[0, axis]) / count
        result[0, axis] = max(box[0, axis], box[0, axis] + (first - 1) * size)
        result[1, axis] = min(box[1, axis], box[0, axis] + (last + 2) * size)
    return result


@dataclass
class _Crossed:
    """The cells that lines cross: (pairs,) numbers of line and cell, and the length in it over the cell's volume."""

    line: NDArray[np.int64]
    cell: NDArray[np.int64]
    length: Array
    lines: int
    shape: tuple[int, int, int]

    @classmethod
    def by(cls, o: Array, d: Array, box: Array, cells: int) -> _Crossed:
        """The cells of a grid in a box."""
        shape = _shape(box, cells)
        counts = np.array(shape)
        size = (box[1] - box[0]) / counts
        safe = np.where(np.abs(d) < _TINY, _TINY, d)
        cuts = [(box[0, a] + size[a] * np.arange(shape[a] + 1) - o[:, a, None]) / safe[:, a, None] for a in range(3)]
        start = np.max([np.minimum(c[:, 0], c[:, -1]) for c in cuts], axis=0)
        stop = np.min([np.maximum(c[:, 0], c[:, -1]) for c in cuts], axis=0)
        hit = np.flatnonzero(stop > start)
        # All planes of a line in order; those outside of the box have no length between them.
        t = np.concatenate([c[hit] for c in cuts], axis=1)
        t = np.sort(np.clip(t, start[hit, None], stop[hit, None]), axis=1)
        length = np.diff(t, axis=1)
        row, column = np.nonzero(length > 1e-9 * (stop - start)[hit, None])
        middle = 0.5 * (t[row, column] + t[row, column + 1])
        where = o[hit[row]] + middle[:, None] * d[hit[row]]
        index = np.clip(((where - box[0]) / size).astype(np.int64), 0, counts - 1)
        cell = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
        return cls(hit[row], cell, length[row, column] / size.prod(), len(o), shape)

    def step(self, mass: Array, weight: Array) -> tuple[Array, Array]:
        """(masses after an iteration, densities of the lines before it)."""
        density = np.bincount(self.line, mass[self.cell] * self.length, self.lines).astype(np.float64)
        share = np.divide(weight, density, out=np.zeros(self.lines), where=density > 0.0)
        mass = mass * np.bincount(self.cell, share[self.line] * self.length, len(mass))
        total = max(float(mass.sum()), 1e-300)
        return mass / total, density

    def even(self) -> Array:
        """Equal masses."""
        cells = int(np.prod(self.shape))
        return np.full(cells, 1.0 / cells)

    def fitted(self, weight: Array, iterations: int) -> Array:
        """Masses, in the shape of the grid, after some iterations from equal ones."""
        mass = self.even()
        for _ in range(iterations):
            mass, _ = self.step(mass, weight)
        return mass.reshape(self.shape)

    def halves(self, weight: Array, most: int, share: float, even: float) -> tuple[int, float]:
        """(iterations, at most ``most``, after which the fit to each half of the lines explains the other half best;
        mean logarithm of the density of the mixture over ``even``)."""
        half = np.arange(self.lines) % 2 == 0
        masses, best = [self.even(), self.even()], (0, -np.inf)
        for iteration in range(most + 1):
            held = np.empty(self.lines)
            for number, part in enumerate((half, ~half)):
                masses[number], density = self.step(masses[number], np.where(part, weight, 0.0))
                held[~part] = density[~part]
            score = float((weight * np.log(share * held / even + 1.0 - share)).sum() / weight.sum())
            if score <= best[1]:
                break
            best = iteration, score
        return best
