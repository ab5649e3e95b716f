r"""Learned emission: lights and directions are selected by the contributions of earlier light paths to the picture.

Let c be the sum of the MIS-weighted contributions of a light path by splats, connections and merges. The variance of
the picture's sum is least if a light l and a cell k of its directions have the probabilities

.. math:: P_l \propto \sqrt{E[P_l^2 c^2 | l]},  \qquad p_k \propto \sqrt{\frac{1}{|k|} \int_k F^2 d\omega},
          \qquad E[c^2 p] = \int F^2 d\omega

where F = c p is the contribution of the direction if it had the probability one. Both expectations are estimated by
sums over the light paths of earlier passes, for any densities of these paths. P is mixed with the selection by power,
and p with the directions of the light's kind, so that no probability is zero and a wrong estimate costs a bounded
factor. The selection of lights by next event is learned in the same way, from the contributions of light points; so is
how much of what a light would contribute arrives, by which its weight at a place is multiplied.

Contributions count relative to the brightness of the picture around their pixel, as in a relative error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, CheckpointError
from etendue.density import Quadtrees
from etendue.scene import LightTable, brightness

from ..emission import EmittedRay
from .departure import Departures
from .worth import SQUARES, UNITS, Worth, capped, in_units

#: A contribution and whether it counts.
Found = tuple["mi.Spectrum", "mi.Bool"]
#: Share of the selection by power.
_BY_POWER = 0.1
#: Weight, in paths, of the mean of all lights in the estimate of a light.
_PRIOR = 1.0
#: Shares of learned directions that are compared. A share above 0 is used if it reduces the second moment below _GAIN
#: times that of share 0, and if the effective number of contributing paths is at least _KNOWN.
SHARES = (0.0, 0.25, 0.5, 0.75)
_GAIN, _KNOWN = 0.9, 64.0
#: Share of a light's density above which a leaf is divided, and least number of effective paths in a leaf.
_LEAF_SHARE, _LEAF_PATHS = 0.01, 4.0


@dataclass
class EmissionSums:
    """Sums over the light paths, and over the next-event samples, of some passes; integers, as float64."""

    count: Array  #: (lights,) light paths
    credit: Array  #: (places,) contributions
    square: Array  #: (places,) squares of contributions
    weighted: Array  #: (places,) squares of contributions times density of the direction
    moments: Array  #: (lights * shares,) squares of contributions if the directions had each of the shares
    direct: Array  #: (lights,) squares of contributions of light points
    unshadowed: Array  #: (lights,) the same as if nothing were in between

    @classmethod
    def zero(cls, lights: int, places: int) -> EmissionSums:
        """No paths."""
        sizes = lights, places, places, places, lights * len(SHARES), lights, lights
        return cls(*(np.zeros(size) for size in sizes))

    def __add__(self, other: EmissionSums) -> EmissionSums:
        return EmissionSums(*(a + b for a, b in zip(self.arrays(), other.arrays(), strict=True)))

    def arrays(self) -> tuple[Array, ...]:
        """The sums in order."""
        return self.count, self.credit, self.square, self.weighted, self.moments, self.direct, self.unshadowed


class EmissionGuide:
    """Learned selection of lights and directions for emission, and learned selection for next event.

    plain: the scene's lights.
    """

    def __init__(self, plain: LightTable) -> None:
        self._plain = plain
        self.count = plain.count
        #: (lights,) learned probabilities of next event and of emission, on the host.
        self.direct = self.emitted = plain.probabilities
        #: (lights,) root of the share of light points' contributions, squared, that arrives.
        self.visible: Array = np.ones(self.count)
        #: Learned densities of directions, one tree per light.
        self.trees = Quadtrees.even(self.count)
        self._share = np.zeros(self.count)
        #: Factor by which learning increases the number of light paths that arrive where they contribute.
        self.crowding = 1.0
        self._upload()

    def _upload(self) -> None:
        #: The lights, with the learned selection.
        self.lights = self._plain
        if self.count > 1:
            self.lights = self._plain.picked_by(self.direct, self.emitted, self.visible)
        self.departures = Departures(self.trees, self._share, self._plain.is_round)

    @property
    def departs(self) -> bool:
        """Whether directions of any light are sampled from a learned density."""
        return bool(self._share.any())

    @property
    def places(self) -> int:
        """Leaves of the densities of all lights."""
        return self.trees.places

    def learn(self, sums: EmissionSums) -> None:
        """Learn from the passes made with this guide since the last call."""
        plain = self._plain.probabilities
        tree = self.trees.tree_of_place()
        square: Array = np.bincount(tree, sums.square, self.count).astype(np.float64)
        credit: Array = np.bincount(tree, sums.credit, self.count).astype(np.float64)
        if self.count > 1 and square.sum() > 0.0:
            each = self.emitted**2 * square
            prior = _PRIOR * each.sum() / sums.count.sum()
            self.emitted = _mixed(np.sqrt((each + prior) / (sums.count + _PRIOR)) * (plain > 0.0), plain)
            more = np.divide(self.emitted, plain, out=np.ones(self.count), where=plain > 0.0)
            self.crowding = max(1.0, float((more * credit).sum() / credit.sum()))
        if self.count > 1 and sums.direct.sum() > 0.0:
            self.direct = _mixed(np.sqrt(self.direct * (sums.direct + 1e-3 * sums.direct.mean())), plain)
            prior = 1e-3 * sums.unshadowed.mean()
            self.visible = np.sqrt(np.minimum((sums.direct + prior) / (sums.unshadowed + prior), 1.0))
        if sums.moments.any():
            self._learn_directions(sums, tree, credit, square)
        self._upload()

    def _learn_directions(self, sums: EmissionSums, tree: NDArray[np.int64], credit: Array, square: Array) -> None:
        """Learn densities and shares. ``tree``: of each place; ``credit`` and ``square``: sums of each light."""
        usable = self._plain.has_directions & (square > 0.0)
        paths = np.where(usable, (credit / UNITS) ** 2 / np.where(usable, square / SQUARES, 1.0), 0.0)
        area = 0.25 ** (np.repeat(self.trees.level, 4) + 1.0)
        self.trees = self.trees.with_mass(np.where(usable[tree], np.sqrt(sums.weighted * area), 0.0))
        leaf = np.maximum(_LEAF_SHARE, _LEAF_PATHS / np.maximum(paths, 1.0))
        self.trees = self.trees.refined(np.arange(self.count), np.where(paths > 0.0, leaf, 1.0))
        # The moments are those of the densities that were sampled; the new densities are better.
        moments = sums.moments.reshape(self.count, -1)
        best = moments.argmin(axis=1)
        gains = usable & (paths >= _KNOWN) & (moments.min(axis=1) < _GAIN * moments[:, 0])
        self._share = np.where(gains, np.array(SHARES)[best], 0.0)

    def state(self) -> dict[str, NDArray[Any]]:
        """The learned state, as arrays that are not modified later."""
        return {
            "direct": self.direct,
            "emitted": self.emitted,
            "visible": self.visible,
            "share": self._share,
            "crowding": np.array(self.crowding),
            **self.trees.to_arrays(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Set the state, as returned by :meth:`state`."""
        self.direct, self.emitted, self.visible, self._share = (
            np.asarray(state[name], np.float64) for name in ("direct", "emitted", "visible", "share")
        )
        self.crowding, self.trees = float(state["crowding"]), Quadtrees.from_arrays(state)
        if len(self.direct) != self.count or self.trees.count != self.count:
            raise CheckpointError("the guide of emission in the checkpoint is damaged; start a new run")
        self._upload()


def _mixed(wanted: Array, plain: Array) -> Array:
    """Probabilities in proportion to ``wanted``, mixed with ``plain``."""
    result: Array = (1.0 - _BY_POWER) * wanted / wanted.sum() + _BY_POWER * plain
    return result


class EmissionTraining(Worth):
    """Contributions of one group of light paths, while they and the camera paths are traced.

    Parameters
    ----------
    guide: the guide that emits the paths.
    unit, levels, width: see :class:`Worth`.
    directions: whether directions are learned, too.
    """

    def __init__(self, guide: EmissionGuide, unit: float, levels: Array, width: int, directions: bool) -> None:
        super().__init__(unit, levels, width)
        self._guide = guide
        self._directions = directions
        #: (paths,) contributions in units; set by :meth:`begin`.
        self.found = mi.UInt64(0)
        #: (lights,) squares of contributions of light points, in units.
        self.direct, self.unshadowed = (dr.zeros(mi.UInt64, guide.count) for _ in range(2))

    def begin(self, emitted: EmittedRay) -> None:
        """Keep the light and the densities of each emitted path."""
        self._light = mi.UInt32(emitted.light)
        self._pdf = mi.Float(emitted.direction_pdf)
        self._ratios: list[mi.Float] = []
        if not self._directions:
            self._place = 4 * emitted.light
            return
        active = emitted.active
        departure = self._guide.departures.at(emitted.light, active)
        learned, self._place = departure.learned(emitted.ray.d, emitted.own_pdf, active)
        # Density of the direction over its density with each of the shares.
        self._ratios = [self._pdf / dr.maximum(a * learned + (1.0 - a) * emitted.own_pdf, 1e-20) for a in SHARES]

    def splatted(self, found: mi.Float) -> None:
        """Set the contributions of the light paths by splats, one lane per path."""
        self.found = in_units(found, UNITS)
        dr.schedule(self._light, self._pdf, self._place, self._ratios, self.found)

    def add(self, path: mi.UInt32, value: mi.Spectrum, worth: mi.Float, active: mi.Bool) -> None:
        """Add a contribution of a light path."""
        units = in_units(brightness(value) * worth, UNITS)
        dr.scatter_add(self.found, units, path, active & (units > 0), dr.ReduceMode.Direct)

    def add_light(self, light: mi.UInt32, found: Found, unshadowed: Found, worth: mi.Float) -> None:
        """Add a contribution of a light point, and the same as if nothing were in between: (value, mask) each."""
        if self._guide.count == 1:
            return
        for sums, (value, active) in ((self.direct, found), (self.unshadowed, unshadowed)):
            units = in_units(dr.square(capped(brightness(value) * worth)), SQUARES)
            dr.scatter_add(sums, units, light, active & (units > 0), dr.ReduceMode.Direct)

    def sums(self) -> EmissionSums:
        """The sums over the paths, once camera paths are done."""
        guide = self._guide
        count = dr.zeros(mi.UInt32, guide.count)
        credit, square, weighted = (dr.zeros(mi.UInt64, guide.places) for _ in range(3))
        dr.scatter_add(count, mi.UInt32(1), self._light, mode=dr.ReduceMode.Direct)
        value = capped(mi.Float(self.found) / UNITS)
        active = self.found > 0
        for sums, amount in (
            (credit, in_units(value, UNITS)),
            (square, in_units(dr.square(value), SQUARES)),
            (weighted, in_units(dr.square(value) * dr.minimum(self._pdf, 1e3), SQUARES)),
        ):
            dr.scatter_add(sums, amount, self._place, active, dr.ReduceMode.Direct)
        moments = dr.zeros(mi.UInt64, guide.count * len(SHARES))
        for number, ratio in enumerate(self._ratios):
            amount = in_units(dr.square(value) * dr.minimum(ratio, 1e3), SQUARES)
            place = self._light * len(SHARES) + number
            dr.scatter_add(moments, amount, place, active, dr.ReduceMode.Direct)
        found = count, credit, square, weighted, moments, self.direct, self.unshadowed
        dr.eval(found)
        return EmissionSums(*(np.array(array).astype(np.float64) for array in found))
