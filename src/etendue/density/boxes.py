r"""A density of rays by the places that they pass: rays of given origins through a few boxes.

With a density rho of points in space, a ray from o is sampled towards a point of density rho. The solid-angle density
of its direction w is that of all points on it,

.. math:: p(w | o) = \int_0^\infty \rho(o + t w) \, t^2 \, dt .

rho is constant in each of a few boxes, so that a ray that is in a box of mass m and volume V from the distance t_0 to
t_1 has there the density m (t_1^3 - t_0^3) / (3 V). A window fits into a thin box, which then is a portal as people
draw them by hand; compare [Bitterli 2015].

:func:`fit_boxes` finds the boxes that make given rays most likely. Masses of the cells of a grid are found by
expectation maximisation [Dempster 1977]; a tree of cuts divides the grid into boxes of about constant density; the
faces of those with most mass are moved as long as that makes the rays likelier.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, copied_to_device, in_steps

#: Boxes, cells of the grid, its iterations, and cuts of the tree, at most.
_BOXES, _CELLS, _ITERATIONS, _CUTS = 4, 512, 8, 24
#: Rays of a fit, as many of which judge it, and the least number of rays.
_MOST, _LEAST = 1 << 10, 1 << 9
#: Rounds in which faces are moved, by what part of a side in the first one, and how this part falls.
_ROUNDS, _MOVE, _LESS, _LEAST_MOVE = 8, 0.5, 0.8, 0.1
#: Iterations for the masses of a few boxes.
_AGAIN = 5
#: Margin around a box, and least side of one, relative to the longest side of all.
_EDGE, _THIN = 1e-3, 1e-3
#: Margin of the next grid around the boxes, relative to the longest side, and most volume of it relative to the last.
_AROUND, _CLOSER = 0.1, 0.7
#: Mass of a box below which it does not count for the next grid.
_LOST = 0.01
#: Least part of the factor on rays that a box must bring: each costs a little time at every vertex.
_WORTH = 0.02
#: Least component of a direction by which lengths are divided.
_TINY = 1e-12


@dataclass(frozen=True)
class Boxes:
    """A density of points on the host: corners (k, 3) of boxes, and their masses (k,), whose sum is the share that the
    boxes have in a mixture."""

    lower: Array
    upper: Array
    mass: Array

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def share(self) -> float:
        """Sum of the masses."""
        return float(self.mass.sum())


class BoxDensity:
    """:class:`Boxes` on the device, alone: of mass 1."""

    def __init__(self, boxes: Boxes) -> None:
        mass = in_steps(boxes.mass / boxes.share, 23)  # as random numbers: boxes are sampled as often as they count
        size = boxes.upper - boxes.lower
        #: For each box its corners, and the density of its points over 3.
        self._boxes = [
            (_opaque(lower), _opaque(upper), dr.opaque(mi.Float, float(density)))
            for lower, upper, density in zip(boxes.lower, boxes.upper, mass / (3.0 * size.prod(axis=1)), strict=True)
        ]
        self._below = [dr.opaque(mi.Float, float(sum_)) for sum_ in np.cumsum(mass)[:-1]]
        # For each box: its lower corner and mass, its sides and the axis of the shortest one.
        rows = np.column_stack([boxes.lower, mass, size, size.argmin(axis=1)])
        self._rows = copied_to_device(mi.Float, rows.astype(np.float32).ravel())

    def sample(self, u: mi.Point2f, depth: mi.Float, active: mi.Bool) -> mi.Point3f:
        """A point; ``u`` is as even on a window as in the square, and ``depth`` is across it."""
        box, below = mi.UInt32(0), mi.Float(0.0)
        for number, sum_ in enumerate(self._below, 1):
            above = u.x >= sum_
            box, below = dr.select(above, mi.UInt32(number), box), dr.select(above, sum_, below)
        corner, side = (dr.gather(mi.Vector4f, self._rows, 2 * box + half, active) for half in (0, 1))
        along = dr.minimum((u.x - below) / dr.maximum(corner.w, _TINY), 1.0)
        point = mi.Vector3f(
            dr.select(side.w == 0.0, depth, along),
            dr.select(side.w == 1.0, depth, dr.select(side.w == 0.0, along, u.y)),
            dr.select(side.w == 2.0, depth, u.y),
        )
        return mi.Point3f(corner.xyz + point * side.xyz)

    def towards(self, o: mi.Point3f, d: mi.Vector3f) -> mi.Float:
        """The solid-angle density of the unit directions ``d`` of rays from ``o``."""
        inverse, found = dr.rcp(dr.select(dr.abs(d) < _TINY, _TINY, d)), mi.Float(0.0)
        for lower, upper, density in self._boxes:
            first, second = (lower - o) * inverse, (upper - o) * inverse
            begin = dr.maximum(dr.max(dr.minimum(first, second)), 0.0)
            end = dr.maximum(dr.min(dr.maximum(first, second)), begin)
            squares = dr.square(begin) + begin * end + dr.square(end)
            found = dr.fma(density * (end - begin), squares, found)
        return found


def _opaque(point: Array) -> mi.Point3f:
    return mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in point))


def fit_boxes(
    o: Array,
    d: Array,
    weight: Array,
    lower: Array,
    upper: Array,
    *,
    replaced: Array,
    kept: Array,
    part: Array | float = 1.0,
    most: float,
) -> tuple[Boxes, float] | None:
    """The boxes between the corners ``lower`` and ``upper`` that make rays most likely, and their share. Rays: origins
    and unit directions (n, 3), weights (n,), densities (n,) ``replaced``, of a sampling of which the boxes take a
    share, at ``most`` so much, and ``kept``, of others. ``part``: probability with which that sampling samples at all,
    of each ray or of all.

    Returns the boxes and the factor by which rays are likelier with them, a geometric mean over rays that the fit has
    not used (but to tell when to look closer); None if there are too few."""
    longest = np.max(np.subtract(upper, lower))
    if len(o) < _LEAST or not weight.sum() > 0.0 or not longest > 0.0:
        return None
    step = max(2, len(o) // _MOST)
    rays = _Rays(o, d, weight, replaced, kept, np.broadcast_to(np.asarray(part, np.float64), len(o)), most)
    fitted, judging = (rays.every(step, first) for first in (0, 1))
    edge = _EDGE * longest  # the room may be flat
    room = Boxes(np.array([lower - edge]), np.array([upper + edge]), np.full(1, most))
    boxes: Boxes | None = None
    score = -np.inf
    while True:
        closer = _fewer(fitted, _refined(fitted, _parted(fitted, room), _THIN * longest))
        found = judging.score(judging.shares(closer), closer.mass)
        if not found > score:
            break
        boxes, score = closer, found
        around = _around(boxes)
        if _volume(around) > _CLOSER * _volume(room):
            break
        room = around
    return None if boxes is None else (boxes, float(np.exp(score)))


@dataclass
class _Rays:
    """Rays, and what is known of their densities, see :func:`fit_boxes`."""

    o: Array
    d: Array
    weight: Array
    replaced: Array
    kept: Array
    part: Array
    most: float

    def every(self, step: int, first: int = 0) -> _Rays:
        """Every so-many-th of them."""
        some = slice(first, None, step)
        rows = {name: getattr(self, name)[some] for name in ("o", "d", "weight", "replaced", "kept", "part")}
        return replace(self, **rows)

    def shares(self, boxes: Boxes) -> Array:
        """(rays, boxes): density of a ray by a box that has all of the share."""
        inverse = 1.0 / np.where(np.abs(self.d) < _TINY, _TINY, self.d)[:, None]
        first, second = ((corner - self.o[:, None]) * inverse for corner in (boxes.lower, boxes.upper))
        begin = np.maximum(np.minimum(first, second).max(axis=2), 0.0)
        end = np.maximum(np.maximum(first, second).min(axis=2), begin)
        volume = (boxes.upper - boxes.lower).prod(axis=1)
        result: Array = self.part[:, None] * (end**3 - begin**3) / (3.0 * volume)
        return result

    def density(self, shares: Array, mass: Array) -> Array:
        """(rays,) in the mixture."""
        result: Array = shares @ mass + (1.0 - mass.sum()) * self.replaced + self.kept
        return result

    def masses(self, shares: Array, mass: Array, iterations: int) -> Array:
        """Masses that make the rays likelier."""
        for _ in range(iterations):
            value = self.weight / self.density(shares, mass)
            mass, rest = mass * (shares.T @ value), (1.0 - mass.sum()) * float(self.replaced @ value)
            share = max(float(mass.sum()), 1e-300)
            mass = mass * (min(share / (share + rest), self.most) / share)
        return mass

    def score(self, shares: Array, mass: Array) -> float:
        """Mean logarithm of the factor by which the mixture makes rays likelier."""
        gain = np.log(self.density(shares, mass) / (self.replaced + self.kept))
        return float((self.weight * gain).sum() / self.weight.sum())


def _fewer(rays: _Rays, boxes: Boxes) -> Boxes:
    """Boxes without those that bring little."""
    shares = rays.shares(boxes)
    while len(boxes) > 1:
        without = [np.arange(len(boxes)) != box for box in range(len(boxes))]
        masses = [rays.masses(shares[:, own], boxes.mass[own], _AGAIN) for own in without]
        scores = [rays.score(shares[:, own], mass) for own, mass in zip(without, masses, strict=True)]
        least = int(np.argmax(scores))
        if scores[least] < rays.score(shares, boxes.mass) - _WORTH:
            break
        own = without[least]
        boxes, shares = Boxes(boxes.lower[own], boxes.upper[own], masses[least]), shares[:, own]
    return boxes


def _volume(boxes: Boxes) -> float:
    return float((boxes.upper - boxes.lower).prod(axis=1).sum())


def _around(boxes: Boxes) -> Boxes:
    """A box around those that have mass, with a margin."""
    own = boxes.mass >= min(_LOST, boxes.mass.max())
    lower, upper = boxes.lower[own].min(axis=0), boxes.upper[own].max(axis=0)
    margin = _AROUND * (upper - lower).max()
    return Boxes(lower[None] - margin, upper[None] + margin, np.full(1, boxes.share))


def _parted(rays: _Rays, room: Boxes) -> Boxes:
    """Boxes of about constant density in the ``room``, those of most mass."""
    lower, extent = room.lower[0], room.upper[0] - room.lower[0]
    shape = np.maximum(np.floor(extent * (_CELLS / extent.prod()) ** (1.0 / 3.0)), 1.0).astype(int)
    while shape.prod() > _CELLS:
        shape[shape.argmax()] -= 1
    size = extent / shape
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    cells = Boxes(lower + places * size, lower + (places + 1) * size, np.full(len(places), rays.most / len(places)))
    few = rays.every(2)
    mass = few.masses(few.shares(cells), cells.mass, _ITERATIONS).reshape(shape)

    leaves = [_Leaf.of(mass, np.zeros(3, int), shape)]
    for _ in range(_CUTS):
        best = max(range(len(leaves)), key=lambda i: leaves[i].gain)
        if leaves[best].gain <= 0.0:
            break
        leaves[best : best + 1] = leaves[best].cut(mass)
    leaves = sorted(leaves, key=lambda leaf: -leaf.mass)[:_BOXES]
    first, last = np.array([leaf.first for leaf in leaves]), np.array([leaf.last for leaf in leaves])
    return Boxes(lower + first * size, lower + last * size, np.full(len(leaves), rays.most / len(leaves)))


@dataclass
class _Leaf:
    """Cells from ``first`` to before ``last``, and the cut that makes the densities of both parts most unlike."""

    first: Array
    last: Array
    mass: float
    gain: float = 0.0  #: of the likelihood, with constant densities in both parts
    axis: int = 0
    place: int = 0

    @classmethod
    def of(cls, mass: Array, first: Array, last: Array) -> _Leaf:
        """With its best cut."""
        own = mass[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        leaf = cls(first, last, float(own.sum()))
        for axis in range(3):
            if own.shape[axis] < 2:
                continue
            below = np.cumsum(own.sum(axis=tuple(a for a in range(3) if a != axis)))[:-1]
            part = np.arange(1, own.shape[axis]) / own.shape[axis]
            gains = _entropy(below, part) + _entropy(leaf.mass - below, 1.0 - part) - _entropy(leaf.mass, 1.0)
            best = int(gains.argmax())
            if gains[best] > leaf.gain:
                leaf.gain, leaf.axis, leaf.place = float(gains[best]), axis, int(first[axis]) + best + 1
        return leaf

    def cut(self, mass: Array) -> list[_Leaf]:
        """Both parts."""
        middle = [corner.copy() for corner in (self.last, self.first)]
        for corner in middle:
            corner[self.axis] = self.place
        return [_Leaf.of(mass, self.first, middle[0]), _Leaf.of(mass, middle[1], self.last)]


def _entropy(mass: Array | float, volume: Array | float) -> Array:
    """Mass times the logarithm of the density."""
    mass = np.maximum(mass, 0.0)
    result: Array = mass * np.log(np.maximum(mass, 1e-300) / volume)
    return result


def _refined(rays: _Rays, boxes: Boxes, least: float) -> Boxes:
    """Boxes with moved faces and other masses, which make the rays likelier; no side becomes smaller than ``least``."""
    corners = np.stack([boxes.lower, boxes.upper])
    shares = rays.shares(boxes)
    mass, part = rays.masses(shares, boxes.mass, _AGAIN), _MOVE
    score = rays.score(shares, mass)
    for _ in range(_ROUNDS):
        for box, axis, side, way in np.ndindex(len(boxes), 3, 2, 2):
            moved = corners[:, box].copy()
            length = moved[1, axis] - moved[0, axis]
            moved[side, axis] += (part if way == side else -part) * length
            if moved[1, axis] - moved[0, axis] < min(least, length):
                continue
            tried = shares.copy()
            tried[:, box] = rays.shares(Boxes(moved[:1], moved[1:], np.ones(1)))[:, 0]
            found = rays.score(tried, mass)
            if found > score:
                corners[:, box], shares, score = moved, tried, found
        mass, part = rays.masses(shares, mass, _AGAIN), max(_LESS * part, _LEAST_MOVE)
        score = rays.score(shares, mass)
    return Boxes(corners[0], corners[1], mass)
