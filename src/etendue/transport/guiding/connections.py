r"""Choice of the light vertices that a camera vertex is connected to, learned by classes of surface points [Su 2022].

A class is a cell of a coarse grid over the scene, and the signed axis nearest to the geometric normal. For a camera
vertex of class i, a class j of light vertices has the probability

.. math:: P(j | i) \propto q_j \sqrt{E[c^2 | i, j]}

where q_j is the share of class j in the light vertices, and c are the MIS-weighted contributions that connections to
vertices of class j have if all vertices have the same probability. This choice has the least variance. A vertex of the
class is then drawn uniformly. One draw in five is uniform over all vertices, so that a wrong estimate costs a bounded
factor.

The weights of all techniques need the ratio of a vertex's probability to a uniform one. The ratio depends on the number
of light vertices that a pass has in the class; the weights of all techniques use the share expected from earlier passes
instead. Contributions count relative to the brightness of the picture around their pixel, as in a relative error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, CheckpointError, copied_to_device
from etendue.scene import brightness

from .worth import SQUARES, Worth, capped, in_units

#: Cells along each axis of the box.
_CELLS = 3
#: Number of classes.
CLASSES = 6 * _CELLS**3
#: Class of the sensor and of the lights.
START = 0xFFFFFFFF
#: Share of the draws that are uniform over all light vertices.
_UNIFORM = 0.2
#: Number of values to which draws are quantised; each value stands for a class.
_SLOTS = 256
#: Weight, in draws, of the camera class's mean in the estimate of a pair of classes, and of the overall mean in the
#: estimate of the camera class.
_PRIOR = 1.0


@dataclass
class ConnectionSums:
    """Sums over the connections, and over the light vertices, of some passes; integers, as float64."""

    count: Array  #: (classes²,) connections for each pair of camera class and light class
    square: Array  #: (classes²,) squares of their contributions
    vertices: Array  #: (classes,) light vertices

    @classmethod
    def zero(cls) -> ConnectionSums:
        """No passes."""
        return cls(np.zeros(CLASSES**2), np.zeros(CLASSES**2), np.zeros(CLASSES))

    def __add__(self, other: ConnectionSums) -> ConnectionSums:
        return ConnectionSums(self.count + other.count, self.square + other.square, self.vertices + other.vertices)


class ConnectionGuide:
    """Learned choice of light vertices. ``lower``, ``upper``: corners of the box of the cells; those at its sides go on
    outside."""

    def __init__(self, lower: Sequence[float] | Array, upper: Sequence[float] | Array) -> None:
        sides = np.maximum(np.subtract(upper, lower), 1e-30)
        self._lower = mi.Point3f(*(dr.opaque(mi.Float, float(v)) for v in lower))
        self._scale = mi.Vector3f(*(dr.opaque(mi.Float, _CELLS / float(side)) for side in sides))
        #: (classes, slots) class of each number of a draw, and (classes,) expected share of the light vertices.
        self._slots = np.zeros((CLASSES, _SLOTS), np.uint16)
        self._expected = np.zeros(CLASSES)
        self._upload()

    def _upload(self) -> None:
        known = bool(self._expected.any())
        self._uniform = dr.opaque(mi.Float, _UNIFORM if known else 1.0)
        rows = np.repeat(np.arange(CLASSES), _SLOTS) * CLASSES
        share = np.bincount(rows + self._slots.ravel(), minlength=CLASSES**2).reshape(CLASSES, CLASSES) / _SLOTS
        share *= 1.0 - _UNIFORM if known else 0.0
        ratio = np.divide(share, self._expected, out=np.zeros_like(share), where=self._expected > 0.0)
        ratio += _UNIFORM if known else 1.0
        self._draws = copied_to_device(mi.UInt32, self._slots.ravel().astype(np.uint32))
        # Share of a class, and ratio of the weights, side by side.
        self._pairs = copied_to_device(mi.Float, np.stack([share, ratio], axis=-1).ravel().astype(np.float32))

    def classify(self, si: mi.SurfaceInteraction3f) -> mi.UInt32:
        """Class of surface points."""
        place = (si.p - self._lower) * self._scale
        cell = [mi.UInt32(dr.clip(v, 0.0, _CELLS - 1.0)) for v in (place.x, place.y, place.z)]
        n, size = si.n, dr.abs(si.n)
        first, second = (size.x >= size.y) & (size.x >= size.z), size.y >= size.z
        along = dr.select(first, n.x, dr.select(second, n.y, n.z))
        axis = dr.select(first, mi.UInt32(0), dr.select(second, mi.UInt32(1), mi.UInt32(2)))
        facing = 2 * axis + dr.select(along < 0.0, mi.UInt32(1), mi.UInt32(0))
        return ((cell[0] * _CELLS + cell[1]) * _CELLS + cell[2]) * 6 + facing

    def draw(self, camera: mi.UInt32, u: mi.Float, active: mi.Bool) -> tuple[mi.Bool, mi.UInt32]:
        """(whether the light vertex is drawn from all classes, else the class) for camera vertices of a class."""
        all_classes = u < self._uniform
        again = dr.clip((u - self._uniform) / dr.maximum(1.0 - self._uniform, 1e-6), 0.0, 1.0)
        slot = dr.minimum(mi.UInt32(again * _SLOTS), _SLOTS - 1)
        return all_classes, dr.gather(mi.UInt32, self._draws, camera * _SLOTS + slot, active & ~all_classes)

    def pair(self, camera: mi.UInt32, light: mi.UInt32, active: mi.Bool | bool = True) -> tuple[mi.Float, mi.Float]:
        """(probability that a draw is from the light vertex's class alone; probability of the vertex over a uniform
        one, as expected) for the ends of an edge; the ratio is 1 if one end is the sensor or a light."""
        known = (camera != START) & (light != START) & active
        share, ratio = dr.gather(mi.Vector2f, self._pairs, camera * CLASSES + light, known)
        return share, dr.select(known, ratio, 1.0)

    def ratio(self, share: mi.Float, held: mi.UInt32, count: mi.UInt32) -> mi.Float:
        """Probability of a light vertex over a uniform one, in a pass with ``held`` of its ``count`` vertices in the
        class of the vertex."""
        return self._uniform + share * (mi.Float(count) / mi.Float(dr.maximum(held, 1)))

    def learn(self, sums: ConnectionSums) -> None:
        """Learn from all passes so far."""
        square, count = (a.reshape(CLASSES, CLASSES) for a in (sums.square, sums.count))
        if not square.any():
            return
        self._expected = sums.vertices / sums.vertices.sum()
        mean = square.sum() / count.sum()
        row = (square.sum(axis=1) + _PRIOR * mean) / (count.sum(axis=1) + _PRIOR)
        moment = (square + _PRIOR * row[:, None]) / (count + _PRIOR)
        wanted = self._expected * np.sqrt(moment)
        self._slots = _quantised(wanted / wanted.sum(axis=1, keepdims=True))
        self._upload()

    def state(self) -> dict[str, NDArray[Any]]:
        """The learned state, as arrays that are not modified later."""
        return {"slots": self._slots, "expected": self._expected}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Set the state, as returned by :meth:`state`."""
        slots, expected = np.asarray(state["slots"], np.uint16), np.asarray(state["expected"], np.float64)
        if slots.shape != (CLASSES, _SLOTS) or expected.shape != (CLASSES,) or slots.max() >= CLASSES:
            raise CheckpointError("the guide of connections in the checkpoint is damaged; start a new run")
        self._slots, self._expected = slots, expected
        self._upload()


def _quantised(probabilities: Array) -> NDArray[np.uint16]:
    """(rows, slots): entries of each row in proportion to its probabilities, by largest remainders."""
    exact = probabilities * _SLOTS
    number = np.floor(exact).astype(np.int64)
    order = np.argsort(number - exact, axis=1, kind="stable")
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.arange(probabilities.shape[1])[None, :], axis=1)
    number += rank < (_SLOTS - number.sum(axis=1, keepdims=True))
    return np.stack([np.repeat(np.arange(CLASSES), row) for row in number]).astype(np.uint16)


class ConnectionTraining(Worth):
    """Contributions of connections, while camera paths are traced. Parameters: see :class:`Worth`."""

    def __init__(self, unit: float, levels: Array, width: int) -> None:
        super().__init__(unit, levels, width)
        self.count = dr.zeros(mi.UInt32, CLASSES**2)
        self.square = dr.zeros(mi.UInt64, CLASSES**2)

    def add(
        self,
        camera: mi.UInt32,
        light: mi.UInt32,
        value: mi.Spectrum,
        worth: mi.Float,
        drawn: mi.Bool,
        active: mi.Bool,
    ) -> None:
        """Add connections that were ``drawn``; the ``active`` ones contribute. ``value``: the contribution if all light
        vertices had the same probability."""
        pair = camera * CLASSES + light
        dr.scatter_add(self.count, mi.UInt32(1), pair, drawn & (worth > 0.0))
        units = in_units(dr.square(capped(brightness(value) * worth)), SQUARES)
        dr.scatter_add(self.square, units, pair, active & (units > 0), dr.ReduceMode.Direct)

    def sums(self, vertices: mi.UInt32) -> ConnectionSums:
        """The sums, once camera paths are done. ``vertices``: (classes,) light vertices of each class."""
        dr.eval(self.count, self.square, vertices)
        return ConnectionSums(*(np.array(a).astype(np.float64) for a in (self.count, self.square, vertices)))
