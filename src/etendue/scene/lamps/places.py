r"""Picking lights by the place that they light.

At a place x, next event picks a group g of lights with the probability

.. math:: P_g(x) = \beta \frac{n_g}{n} + (1 - \beta) \frac{w_g(x)}{\sum_h w_h(x)},

where w is the fluence of the group at x if nothing is in between: of lamps J / (d^2 + s^2), with the radiant intensity
J towards x, the distance d and the extent s of the group; of infinite lights the same everywhere. n_g of the n lights
belong to the group; learned probabilities may take the place of n_g / n. Every light is a group of its own, if there
are at most :data:`MOST_GROUPS`; else lamps near to each other are a group, in which they are picked by the
probabilities of the table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device, in_steps

if TYPE_CHECKING:
    from .table import Light, LightTable

#: Most groups of lights; each costs a few operations per sample.
MOST_GROUPS = 16
#: Probability beta of picking a light whatever the place.
ANYWHERE = 0.5


@dataclass
class Lamp:
    """What a light shines at a place: the host's description of a row of the light table.

    The intensity towards a direction at the cosine c to ``axis`` is ``power`` / (4 pi) times (``even`` + ``slope`` c),
    or 0 if c is below ``least``; for an infinite light, ``power`` is the fluence everywhere.
    """

    power: float
    centre: Sequence[float] = (0.0, 0.0, 0.0)
    extent: float = 0.0  #: about the radius of its sphere
    axis: Sequence[float] = (0.0, 0.0, 0.0)
    even: float = 1.0
    slope: float = 0.0
    least: float = -2.0
    is_infinite: bool = False


class Groups:
    """Groups of the lights of a scene, on the device.

    Parameters
    ----------
    lamps: of each row of the light table.
    probabilities: (rows,) of the table, for picking in a group; a light with 0 is never picked, but has a place in a
        group, so that lamps may be switched off and on without other kernels.
    visible: (rows,) learned factors on what lamps shine at a place; then ``probabilities`` are learned, too, and are
        those of picking whatever the place.
    """

    def __init__(self, lamps: Sequence[Lamp], probabilities: Array, visible: Array | None = None) -> None:
        self.lamps = lamps
        lit = probabilities > 0.0
        anywhere = lit / lit.sum() if visible is None else probabilities / probabilities.sum()
        factors = np.where(lit, 1.0 if visible is None else visible, 0.0)
        lamps = [replace(lamp, power=lamp.power * factor) for lamp, factor in zip(lamps, factors, strict=True)]
        infinite = [row for row, lamp in enumerate(lamps) if lamp.is_infinite]
        finite = [row for row, lamp in enumerate(lamps) if not lamp.is_infinite]
        members = [[row] for row in infinite] if len(infinite) <= MOST_GROUPS // 4 else [infinite]
        places = np.array([lamps[row].centre for row in finite]).reshape(-1, 3)
        parts = [[finite[i] for i in part] for part in _parted(places, MOST_GROUPS - len(members))]
        # In an order that does not depend on the places, so that lamps may be moved without other kernels.
        members += sorted(parts, key=lambda rows: (len(rows) > 1 or not any(lamps[rows[0]].axis), min(rows)))
        together = [_together([lamps[row] for row in rows]) for rows in members]
        brightest = max(lamp.power for lamp in together) or 1.0
        #: Of each group on the device: numbers that differ are opaque, so that kernels do not contain them.
        self.infinite = [lamp.is_infinite for lamp in together]
        self.aimed = [any(lamp.axis) for lamp in together]
        self.anywhere = [dr.opaque(mi.Float, float(anywhere[rows].sum())) for rows in members]
        self.power = [dr.opaque(mi.Float, _fluence(lamp) / brightest) for lamp in together]
        self.centre = [_opaque(lamp.centre) for lamp in together]
        self.spread = [dr.opaque(mi.Float, max(lamp.extent, 1e-6) ** 2) for lamp in together]
        self.axis = [_opaque(lamp.axis) for lamp in together]
        self.shape = [_opaque((lamp.even, lamp.slope, lamp.least)) for lamp in together]
        # Lights in the order of the groups, and (group + sum of the probabilities in it up to a light) of each. The
        # probabilities in a group are multiples of 2^-18, so that these sums are exact.
        self.is_single = all(len(rows) == 1 for rows in members)
        order, sums = np.concatenate(members), []
        group, share = np.zeros(len(probabilities), np.uint32), np.zeros(len(probabilities))
        for number, rows in enumerate(members):
            own = in_steps(probabilities[rows], 18) if lit[rows].any() else np.full(len(rows), 1.0 / len(rows))
            group[rows], share[rows] = number, own
            sums.append(number + np.cumsum(own))
        self.order = copied_to_device(mi.UInt32, order.astype(np.uint32))
        self.sums = copied_to_device(mi.Float, np.concatenate(sums).astype(np.float32))
        self.group = copied_to_device(mi.UInt32, group)
        self.share = copied_to_device(mi.Float, share.astype(np.float32))

    def weights(self, p: mi.Point3f) -> list[mi.Float]:
        """Probabilities of the groups at a place, times any number."""
        fluence = [self._fluence(number, p) for number in range(len(self.power))]
        total = dr.maximum(sum(fluence), 1e-30)
        return [
            ANYWHERE * share * total + (1.0 - ANYWHERE) * own for share, own in zip(self.anywhere, fluence, strict=True)
        ]

    def _fluence(self, number: int, p: mi.Point3f) -> mi.Float:
        power = self.power[number]
        if self.infinite[number]:
            return mi.Float(power)
        offset = p - self.centre[number]
        distance_squared = dr.squared_norm(offset) + self.spread[number]
        result = power / distance_squared
        if self.aimed[number]:
            cos = dr.dot(offset, self.axis[number]) * dr.rsqrt(distance_squared)
            even, slope, least = self.shape[number]
            result *= dr.select(cos >= least, even + slope * cos, 0.0)
        return result


class LightsAt:
    """A light table whose lights next event picks by the place that they light, one place per lane."""

    def __init__(self, table: LightTable, p: mi.Point3f | None = None) -> None:
        self.table = table
        self.has_area, self.has_point = table.has_area, table.has_point
        self.has_infinite, self.has_beam = table.has_infinite, table.has_beam
        self.points, self.has_sphere, self.has_smooth = table.points, table.has_sphere, table.has_smooth
        self.lines, self.windows, self.bound = table.lines, table.windows, table.bound
        self._groups = table.groups
        self._weights = [] if p is None or self._groups is None else self._groups.weights(p)  # empty: by the table

    def at(self, p: mi.Point3f) -> LightsAt:
        """These lights: they have their place."""
        return self

    def chance(self, row: mi.UInt32, active: mi.Bool | bool = True) -> mi.Float:
        """Probability of the light ``row``."""
        if self._groups is None or not self._weights:
            return self.table.row(row, active).pick
        group, own = dr.gather(mi.UInt32, self._groups.group, row, active), mi.Float(0.0)
        for number, weight in enumerate(self._weights):
            own = dr.select(group == number, weight, own)
        return dr.gather(mi.Float, self._groups.share, row, active) * own / sum(self._weights)

    def drawn(self, u: mi.Float, active: mi.Bool | bool = True) -> mi.UInt32:
        """The light that the number ``u`` picks."""
        groups = self._groups
        if groups is None or not self._weights:
            return self.table.pick(u, active).row
        # Below the sum also after rounding: a light that is not lit may be the last one.
        left = dr.minimum(u, 1.0 - 2.0**-22) * sum(self._weights)
        group, below = mi.UInt32(0), mi.Float(0.0)
        own, before = mi.Float(self._weights[0]), mi.Float(0.0)
        for number, weight in enumerate(self._weights[1:], 1):
            below = below + self._weights[number - 1]
            here = left >= below
            group = dr.select(here, mi.UInt32(number), group)
            own, before = dr.select(here, weight, own), dr.select(here, below, before)
        if groups.is_single:
            return dr.gather(mi.UInt32, groups.order, group, active)
        within = dr.minimum((left - before) / own, 1.0 - 2.0**-18)
        last = dr.width(groups.order) - 1
        place = dr.binary_search(
            0, last, lambda i: dr.gather(mi.Float, groups.sums, i, active) <= mi.Float(group) + within
        )
        return dr.gather(mi.UInt32, groups.order, place, active)

    def pick(self, u: mi.Float, active: mi.Bool | bool = True) -> Light:
        """As :meth:`LightTable.pick`, with the probabilities of the place."""
        return self.row(self.drawn(u, active), active)

    def of(self, emitter: mi.EmitterPtr, active: mi.Bool | bool = True) -> Light:
        """As :meth:`LightTable.of`."""
        return self.row(self.table.of(emitter, active).row, active)

    def row(self, row: mi.UInt32, active: mi.Bool | bool = True) -> Light:
        """As :meth:`LightTable.row`."""
        light = self.table.row(row, active)
        light.pick = self.chance(row, active)
        return light


def _fluence(lamp: Lamp) -> float:
    """Fluence, times the squared distance for a lamp that shines evenly."""
    return lamp.power if lamp.is_infinite else lamp.power / (4.0 * np.pi)


def _opaque(vector: Sequence[float]) -> mi.Vector3f:
    return mi.Vector3f(*(dr.opaque(mi.Float, float(value)) for value in vector))


def _together(lamps: Sequence[Lamp]) -> Lamp:
    """Lamps of a group as one lamp."""
    if len(lamps) == 1:
        return lamps[0]
    power = np.array([lamp.power for lamp in lamps])
    weight = power if power.sum() > 0.0 else np.ones(len(lamps))
    places = np.array([lamp.centre for lamp in lamps])
    centre = weight @ places / weight.sum()
    squares = ((places - centre) ** 2).sum(axis=1) + np.array([lamp.extent for lamp in lamps]) ** 2
    extent = float(np.sqrt(weight @ squares / weight.sum()))
    return Lamp(float(power.sum()), centre.tolist(), extent, is_infinite=lamps[0].is_infinite)


def _parted(places: Array, most: int) -> list[NDArray[np.int64]]:
    """At most ``most`` groups of places near to each other: the widest one is halved along its longest side."""
    parts = [np.arange(len(places))] if len(places) else []
    while len(parts) < min(most, len(places)):
        wide = [float(np.ptp(places[part], axis=0).max()) if len(part) > 1 else -1.0 for part in parts]
        part = parts.pop(int(np.argmax(wide)))
        along = places[part][:, int(np.argmax(np.ptp(places[part], axis=0)))]
        ordered = part[np.argsort(along, kind="stable")]
        parts += [ordered[: len(part) // 2], ordered[len(part) // 2 :]]
    return parts
