r"""Multiplexed Metropolis light transport.

A path of k edges can be made by n_k techniques: s vertices on a light sub-path, the others on a camera sub-path. Two
of the random numbers of a sample are its length k, drawn with probability P(k), and its technique, drawn uniformly; the
target is the luminance of

.. math:: c = \frac{n_k}{P(k)} \, w_{s,t} \, \frac{f}{p_{s,t}}

with the weight w of bidirectional path tracing, so that chains spend their time on the techniques that contribute most
to a path [Hachisuka 2014]. Small steps keep the length; large ones draw it anew, in proportion to the light of a pilot.

Limit: as in ``pssmlt``, chains explore only light that independent samples have found.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import IndependentSource, OptionError, SampleSource, on_device, setting
from etendue.film import COMPONENTS
from etendue.integration import Layout, Slot
from etendue.transport import Mis, SingleContribution, SingleTechnique, Techniques, dimensions as dim

from ..base import ImageMethod, ImageSettings, keep_finite
from .method import MetropolisMethod, MetropolisSettings
from .targets import (
    ROULETTE,
    Contribution,
    Target,
    Traced,
    brightness,
    camera_slots,
    film_place,
    light_slots,
    wavelengths_of,
)

#: Number of lengths with a probability of their own, number of the last of these, and limits of the probability of a
#: further edge. Longer paths share the last length: each further edge has the same probability, the ratio per edge by
#: which light decreases in the pilot, from one half of the last lengths to the other. The square of a contribution over
#: its probability has a finite mean while the probability of an edge is above the square of that ratio.
_LENGTHS, _LAST, _LONGER = 12, 8, (0.5, 0.98)
#: Share of the probabilities of lengths that the pilot does not change, and samples of the pilot.
_EVEN, _PILOT = 0.2, 1 << 16


@dataclass(frozen=True)
class MmltSettings(MetropolisSettings):
    """Settings of ``mmlt``."""

    rr_depth: int = setting(
        5, "without effect: the length of a path is chosen before it is sampled, and no roulette ends it", minimum=1
    )


class SingleTarget:
    """One technique of bidirectional path tracing a sample."""

    def __init__(self, method: ImageMethod, vertices: int, seed: int) -> None:
        self._method: ImageMethod = weakref.proxy(method)  # which owns the target
        can_splat = method.camera.can_splat
        techniques = Techniques(splat=can_splat, merge=False)
        self._single = SingleTechnique(
            visibility=method.visibility,
            lights=method.lights,
            camera=method.camera,
            mis=Mis(techniques, [0.0], dr.opaque(mi.Float, float(method.camera.pixels))),
            max_edges=method.edges,
            components=method.settings.components,
        )
        self._last = 1 if can_splat else 0  # techniques of a path of k >= 2 edges, minus k
        depth = method.settings.max_depth
        if depth == 0:
            raise OptionError("mmlt needs paths of at least one edge; set max_depth to 1 or more, or to -1")
        end, inner = camera_slots(method)
        # The only light point of a camera sub-path has the numbers of vertex 0.
        single = [slot for slot in inner if slot.component >= dim.NEXT_EVENT]
        end = [*end, Slot(dim.LENGTH, still=True), Slot(dim.TECHNIQUE), *single]
        inner = [slot for slot in inner if slot.component < dim.NEXT_EVENT]
        light, crossing = light_slots(method), [ROULETTE] if method.visibility.transparent else []
        self.layouts: Mapping[str, Layout] = {
            "camera": Layout(end, [*inner, *crossing], vertices),
            "light": Layout(light[0], [*light[1], *crossing], vertices),
        }
        #: Number of lengths beyond the last one of the table.
        self._beyond = math.inf if depth < 0 else max(depth - _LENGTHS, 0)
        self._even = np.ones(_LENGTHS if depth < 0 else min(depth, _LENGTHS))
        self._set_lengths(self._even, None)
        self._pilot(seed)

    def _set_lengths(self, weights: NDArray[np.float64], longer: float | None) -> None:
        """Probabilities of the lengths of the table, and of each further edge; ``None``: no further ones."""
        probabilities = weights / weights.sum()
        self._lengths = len(probabilities)
        self._probability = on_device(mi.Float, probabilities)
        self._reached = on_device(mi.Float, np.cumsum(probabilities))
        #: q of the geometric distribution of further edges, and the share of this distribution within the limit.
        self.longer = longer
        self._kept = 1.0 if longer is None else 1.0 - longer ** (self._beyond + 1.0)

    def _pilot(self, seed: int) -> None:
        """Draw lengths in proportion to their luminance in a pilot that draws them evenly."""
        lane = dr.arange(mi.UInt32, _PILOT)
        sources = {name: IndependentSource(lane, seed, f"pilot {name}", 0) for name in self.layouts}
        length, _ = self._length(sources["camera"].next_1d(0, dim.LENGTH))
        found = sum(brightness(one.value) for one in self.trace(sources, _PILOT).contributions)
        dr.eval(length, found)
        values = np.array(found, np.float64)
        values = np.minimum(values, 100.0 * max(values.mean(), 0.0))
        sums = np.bincount(np.array(length) - 1, values, self._lengths)
        longer = None
        if self._beyond:
            early, late = sums[-_LAST:].reshape(2, -1).sum(axis=1)
            ratio = (late / early) ** (2.0 / _LAST) if early > 0.0 else 1.0
            longer = float(np.clip(ratio, *_LONGER))
            sums[-1] *= (1.0 - longer ** (self._beyond + 1.0)) / (1.0 - longer)
        if not sums.any():
            sums = self._even
        self._set_lengths((1.0 - _EVEN) * sums / sums.sum() + _EVEN * self._even / self._even.sum(), longer)

    def _length(self, u: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        """(edges of the path that a number draws, probability)."""
        last = self._lengths - 1
        index = dr.binary_search(0, last, lambda i: dr.gather(mi.Float, self._reached, i) <= u)
        index = dr.minimum(mi.UInt32(index), last)
        probability = dr.gather(mi.Float, self._probability, index)
        if self.longer is None:
            return index + 1, probability
        below = dr.select(index > 0, dr.gather(mi.Float, self._reached, dr.maximum(index, 1) - 1), 0.0)
        rest = dr.clip((u - below) / probability, 0.0, 1.0 - 2.0**-24)
        q, kept = dr.opaque(mi.Float, self.longer), dr.opaque(mi.Float, self._kept)
        more = dr.floor(dr.log(1.0 - rest * kept) / dr.log(q))
        longer = dr.select(index == last, dr.minimum(more, dr.opaque(mi.Float, min(self._beyond, 1e6))), 0.0)
        further = dr.select(index == last, (1.0 - q) / kept * dr.power(q, longer), 1.0)
        return index + 1 + mi.UInt32(longer), probability * further

    def single(
        self, sources: Mapping[str, SampleSource], length: mi.UInt32, place: mi.Point2f, lanes: int
    ) -> tuple[SingleContribution, mi.Float]:
        """(contribution of paths of ``length`` edges, number of their techniques)."""
        count = dr.select(length == 1, mi.UInt32(1), length + self._last)
        s = dr.minimum(mi.UInt32(sources["camera"].next_1d(0, dim.TECHNIQUE) * mi.Float(count)), count - 1)
        return self._single.trace(s, length + 1 - s, place, sources["camera"], sources["light"]), mi.Float(count)

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """See :class:`Target`."""
        camera = sources["camera"]
        length, probability = self._length(camera.next_1d(0, dim.LENGTH))
        with wavelengths_of(self._method, camera):
            found, count = self.single(sources, length, film_place(self._method, camera), lanes)
            value, bad = keep_finite(self._method.packet.rgb(found.value * (count / probability)))
        contributions = [Contribution(found.position, value)]
        if found.component is not None:
            contributions = [
                Contribution(found.position, dr.select(found.component == number, value, 0.0), number)
                for number in range(len(COMPONENTS))
            ]
        return Traced(contributions, found.rays, dr.select(bad, mi.UInt32(1), 0))

    def reads(self) -> Sequence[object]:
        """See :class:`Target`."""
        return self._single, self._probability, self._reached, *self._method.tables()

    def had_room(self, wanted: int, lanes: int) -> bool:
        """See :class:`Target`."""
        return True


class Mmlt(MetropolisMethod):
    """Chains over the random numbers of camera and light paths, each joined by one technique."""

    name: ClassVar[str] = "mmlt"
    Settings: ClassVar[type[ImageSettings]] = MmltSettings
    settings: MmltSettings
    citations: ClassVar[tuple[str, ...]] = ("Hachisuka2014", "Kelemen2002", "VeachGuibas1997", "Georgiev2012b")

    def make_target(self, seed: int) -> Target:
        """See :class:`MetropolisMethod`."""
        return SingleTarget(self, self.settings.vertices, seed)
