"""Multiple importance sampling over all techniques, with weights computed recursively from two numbers per sub-path.

A path with k edges can be sampled by hitting the light (emission), by next event, by connecting two inner vertices, by
connecting a light sub-path to the camera (splat), and by merging at any inner vertex. The weight of technique i is
``(n_i p_i)^beta / sum_j (n_j p_j)^beta`` [Veach 1997, eq. 9.8; Georgiev 2012, eq. 7]. Its denominator is computed from
two numbers that each sub-path carries, in O(1) operations per vertex [Georgiev 2012b, sec. 4]. The report's quantities
are dVCM, dVC and dVM; here

- ``d_vcm`` is the report's dVCM times the sample count of the technique that it describes, and
- ``d_vc`` is dVC; with merging but no connections it is ``eta_vm * dVM``. dVM is never stored: with connections and
  merging it equals dVC / eta_vm [Georgiev 2012b, eq. 20 in 35 and 36].

The sample count of a technique is a factor wherever the technique is added to a sum. The weights therefore sum to one
for any set of techniques with any counts; a count of zero removes a technique from the estimator and from the weights.
Cosines are those of the geometric normal. Russian roulette is left out of all densities, which causes no bias, because
the weights of a path then do not depend on the technique that samples it.

Merging divides by the cosine at which light arrives at the photon's surface; the quotient is unbounded near zero. If
there are techniques that connect vertices, a vertex with a cosine below :data:`GRAZING` is therefore not merged, in the
estimator and in the weights; if there are none, the quotient is bounded (:meth:`Mis.fluence`).

Connections may prefer some light vertices to others. The count of a connection is then multiplied by the ratio of its
light vertex's probability to that of a uniform choice, which depends on the two ends of its edge alone, so that every
technique of a path has the same ratio for the same edge.

Light that a wide scattering has sent is found by connections, too, and few of its light vertices are worth merging. At
a vertex to which the one before scatters light with a density of at most ``kinds.WIDE``, the count of merges is
therefore multiplied by ``techniques.diffuse``. The light walk knows that density, the camera walk one vertex later:
what it adds to d_vc for merges waits until then (:class:`Left`).

In participating media, densities are per volume at a vertex in a medium, and those of an edge include the probability
of passing its media (:mod:`..flight`): wherever a density of an edge is used, it is multiplied by that of
:class:`Passing`, and the cosine of a vertex in a medium is 1.

Both numbers are linear in the sample counts of splats, connections and merges. For several sets of counts (several
merging radii, or candidates whose second moments are estimated), a sub-path carries the coefficients
(:class:`Linear`), and the sums are evaluated for each set.
"""

from __future__ import annotations

import copy
import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..flight import Passing
from .kinds import Kind, is_wide
from .linear import Carried, Counts, Linear
from .techniques import Techniques

#: Least geometric cosine that merging divides by.
GRAZING = 0.02
#: Least density of a path under a candidate's counts, relative to that under the counts in use.
_NEVER = 1e-6


class Weights(list[Any]):
    """Weights of a contribution, one per radius, and ``ratios``, one per candidate: the weights' denominator over that
    for the candidate's counts."""

    def __init__(self, weights: Sequence[mi.Float], ratios: Sequence[mi.Float] = ()) -> None:
        super().__init__(weights)
        self.ratios = ratios


@dataclass
class Left:
    """Terms of d_vc of a camera sub-path that depend on its next vertex."""

    merge: mi.Float | Linear | None  #: of merging at the last vertex
    splat: mi.Float | Linear | None  #: of the splat of the first vertex


class Mis:
    """The recursion and the weights for one set of techniques. Weights are lists with one entry per merging radius.

    Parameters
    ----------
    techniques: the sample counts.
    eta_vm: number of light paths times the area of the merging disc, n_VM pi r^2 [Georgiev 2012b, eq. 20], for each
        radius; opaque scalars if they change from pass to pass. Ignored without merging.
    paths_per_sample: light sub-paths of a pass over camera paths of a pixel, n_LP.
    candidates: other counts, for which :class:`Weights` have ratios.
    """

    def __init__(
        self,
        techniques: Techniques,
        eta_vm: Sequence[mi.Float | float],
        paths_per_sample: mi.Float | float,
        candidates: Sequence[Counts] = (),
    ) -> None:
        self.techniques = techniques
        self.paths_per_sample = paths_per_sample
        etas = [self.power(eta) for eta in eta_vm] if techniques.merge else [0.0]
        own = self.power(paths_per_sample), self._count(techniques.connection)
        self._sets = [Counts(*own, eta) for eta in etas]
        self.candidates = [
            Counts(*(self.power(count) for count in (c.splat, c.connection, c.merge))) for c in candidates
        ]
        #: Whether d_vcm and d_vc are :class:`Linear`, because there are several sets of counts.
        self.linear = len(self._sets) > 1 or bool(self.candidates)
        # The term that the recursion adds at vertices that can be merged.
        self._eta: Linear | mi.Float | float = Linear(0.0, 0.0, 1.0) if self.linear else etas[0]
        self._share: mi.Float | float = 1.0

    def at(self, share: mi.Float | None) -> Mis:
        """The weights at a vertex where the merging disc has a ``share`` of the area that ``eta_vm`` stands for; None:
        all of it. The share is a function of the position alone, so that every technique of a path has the same."""
        if share is None:
            return self
        here = copy.copy(self)
        here._share = self.power(share)
        here._eta = self._eta * here._share
        return here

    def power(self, x: mi.Float | float) -> mi.Float:
        """``x^beta``."""
        return x * x if self.techniques.beta == 2 else x

    def _count(self, n: int) -> float:
        return float(n**self.techniques.beta)

    def _start(self, value: mi.Float) -> Carried:
        if not self.linear:
            return value
        zeros = [dr.zeros(mi.Float, dr.width(value)) for _ in range(2)]
        return Linear(value, *zeros)

    def _at(self, light: Carried | float, camera: Carried | float, more: mi.Float | float = 0.0) -> list[mi.Float]:
        """Sum of a light sub-path's sum, a camera sub-path's and ``more``, evaluated for each set of counts and each
        candidate."""
        sums = []
        for counts in (*self._sets, *self.candidates):
            by_light = light.at(counts) if isinstance(light, Linear) else light
            by_camera = camera.at(counts, counts.splat) if isinstance(camera, Linear) else camera
            sums.append(by_light + by_camera + more)
        return sums

    def _weights(self, own: Sequence[mi.Float | float], others: Sequence[mi.Float]) -> Weights:
        """Weights of a technique with the counts ``own``, one per set, and ratios; ``others``: the other techniques'
        densities times counts, relative to the technique's density."""
        totals = [n + other for n, other in zip(own, others, strict=True)]
        used = len(self._sets)
        # The bound is for paths that a candidate's counts cannot sample.
        ratios = [totals[0] / dr.maximum(total, _NEVER * totals[0]) for total in totals[used:]]
        return Weights([n / total for n, total in zip(own[:used], totals[:used], strict=True)], ratios)

    def _own(self, count: float) -> list[float]:
        """The same count in all sets."""
        return [count] * (len(self._sets) + len(self.candidates))

    # ------------------------------------------------------------------ light sub-path

    def start_light(
        self, area_density: mi.Float, emission_density: mi.Float, cos_light: mi.Float, is_delta: mi.Bool
    ) -> tuple[Carried, Carried]:
        """(d_vcm, d_vc) of an emitted ray [Georgiev 2012b, eq. 31, 32].

        ``area_density``: density of the light point under next event (of the direction, for an infinite light);
        ``emission_density``: density of point and direction; both include light selection. If the former depends on
        the lit point, pass any positive number, and correct the result with :meth:`lit` when that point is known.
        """
        t = self.techniques
        d_vcm = self.power(area_density / emission_density) * self._count(t.next_event)
        emission = self._count(t.emission) if t.connects else 0.0
        d_vc = dr.select(is_delta, 0.0, self.power(cos_light / emission_density) * emission)
        return self._start(d_vcm), self._start(d_vc)

    def lit(self, d_vcm: Carried, ratio: mi.Float) -> Carried:
        """``d_vcm`` of an emitted ray that has hit x_1; ``ratio``: density p(x_0 | x_1) of the light point under next
        event, over the ``area_density`` that :meth:`start_light` was called with. To be called before :meth:`hit`.

        d_vc does not contain this density [Georgiev 2012b, eq. 31].
        """
        return d_vcm * self.power(ratio)

    # ------------------------------------------------------------------ camera sub-path

    def start_camera(self, pixel_density: mi.Float) -> tuple[Carried, Carried]:
        """(d_vcm, d_vc) of a camera ray; ``pixel_density``: its solid-angle density for a point uniform in its pixel.
        0 where the sensor cannot be splatted to: the weights then do not contain the splat [Georgiev 2012b, eq. 31]."""
        ok = (pixel_density > 0.0) & self.techniques.splat
        count = 1.0 if self.linear else self.paths_per_sample
        d_vcm = dr.select(ok, self.power(count / dr.select(ok, pixel_density, 1.0)), 0.0)
        return self._start(d_vcm), self._start(dr.zeros(mi.Float, dr.width(d_vcm)))

    # ------------------------------------------------------------------ both

    def hit(self, d_vcm: Carried, d_vc: Carried, distance_squared: mi.Float, cos: mi.Float) -> tuple[Carried, Carried]:
        """(d_vcm, d_vc) after a hit, which converts densities from solid angle to area; ``cos``: absolute cosine at the
        surface that was hit."""
        inverse = dr.rcp(self.power(dr.maximum(cos, 1e-8)))  # against 0 * inf for tangential rays
        return d_vcm * self.power(distance_squared) * inverse, d_vc * inverse

    def passed(self, d_vcm: Carried, d_vc: Carried, passing: Passing) -> tuple[Carried, Carried]:
        """(d_vcm, d_vc) after an edge through media, to be called before :meth:`hit`: its densities are those of a
        vacuum times those of ``passing``, in both directions. The transmittance cancels in d_vc, unless an end is in a
        medium or the extinction depends on the colour."""
        inverse = dr.rcp(self.power(dr.maximum(passing.to_end, 1e-30)))
        return d_vcm * inverse, d_vc * (self.power(passing.to_start) * inverse)

    def joined(self, depth: mi.UInt32, d_vcm: Carried, ratio: mi.Float | None = None) -> Carried:
        """``d_vcm`` of a camera vertex, scaled by the sample count of the technique that connects along the edge before
        it: 1 for the splat at the first vertex, that of connections after; ``ratio``: see :meth:`chosen`. The walk
        keeps it unscaled, because the weight of emission needs it for next event along the same edge."""
        count = self._count(self.techniques.connection)
        if count != 1.0 and not self.linear:
            d_vcm = d_vcm * dr.select(depth == 1, 1.0, count)
        return self.chosen(d_vcm, ratio)

    def chosen(self, d_vcm: Carried, ratio: mi.Float | None) -> Carried:
        """``d_vcm`` after a hit, if connections prefer some light vertices; ``ratio``: probability of the edge's light
        vertex for its camera vertex over that of a uniform choice, 1 on the edge of the sensor or a light."""
        if ratio is None:
            return d_vcm
        if isinstance(d_vcm, Linear):
            return Linear(d_vcm.end, d_vcm.connection * self.power(ratio), d_vcm.merge)
        return d_vcm * self.power(ratio)

    def fluence(self, cos: mi.Float) -> mi.Float:
        """1 / cos: fluence of light of unit flux per area that arrives at a surface at this geometric cosine; 0 where
        vertices are not merged."""
        bounded = dr.rcp(dr.maximum(cos, GRAZING))
        return dr.select(cos >= GRAZING, bounded, 0.0) if self.techniques.connects else bounded

    def merged(self, kind: mi.UInt32) -> mi.Float | None:
        """Share of the light vertices of a :class:`Kind` that are merged; None: all of any."""
        if not self.techniques.waits:
            return None
        diffuse = (kind == mi.UInt32(Kind.DIFFUSE)) | (kind == mi.UInt32(Kind.UNMERGED))
        share = dr.select(diffuse, mi.Float(self.techniques.diffuse), 1.0)
        return dr.select(kind == mi.UInt32(Kind.DIRECT), 0.0, share) if self.techniques.leaves_direct else share

    def merged_after(self, pdf: mi.Float, is_delta: mi.Bool | bool = False) -> mi.Float | None:
        """Share of the light vertices that are merged where light arrives from a scattering of this density; None:
        all."""
        if not self.techniques.thins:
            return None
        return dr.select(is_wide(pdf, is_delta), mi.Float(self.techniques.diffuse), 1.0)

    def _merge_area(
        self, cos: mi.Float, depth: mi.UInt32 | None = None, merged: mi.Float | None = None
    ) -> Carried | None:
        """``eta_vm`` of a vertex at which light arrives at this geometric cosine, 0 where it cannot be merged; None
        without merging. ``depth``: of a camera vertex; ``merged``: share of the light vertices there that are."""
        if not self.techniques.merge:
            return None
        mergeable = self.fluence(cos) > 0.0
        if depth is not None and not self.techniques.merge_first:
            mergeable &= depth != 1
        return self._eta * dr.select(mergeable, mi.Float(1.0) if merged is None else self.power(merged), 0.0)

    def _sum(self, eta: Carried | None, d_vcm: Carried, reverse_pdf: mi.Float, d_vc: Carried) -> Carried:
        """Sum of the densities, over that of the sub-path, of the techniques that connect or merge at the sub-path's
        end vertex or before it."""
        total = d_vc * self.power(reverse_pdf)
        if self.techniques.connects:
            total = total + d_vcm
        return total if eta is None else total + eta

    def scatter_light(
        self,
        d_vcm: Carried,
        d_vc: Carried,
        light_cos: mi.Float,
        cos: mi.Float,
        pdf: mi.Float,
        reverse_pdf: mi.Float,
        is_delta: mi.Bool,
        merged: mi.Float | None = None,
    ) -> tuple[Carried, Carried]:
        """(d_vcm, d_vc) after scattering at a light vertex [Georgiev 2012b, eq. 34, 35; delta: 53, 54]. ``light_cos``
        and ``cos``: geometric cosines of the incoming and of the sampled direction; ``merged``: see :meth:`merged`."""
        total = self._sum(self._merge_area(light_cos, merged=merged), d_vcm, reverse_pdf, d_vc)
        return self._scatter(total, d_vc, cos, pdf, is_delta, self._count(self.techniques.connection))

    def scatter_camera(
        self,
        depth: mi.UInt32,
        d_vcm: Carried,
        d_vc: Carried,
        cos: mi.Float,
        pdf: mi.Float,
        reverse_pdf: mi.Float,
        is_delta: mi.Bool,
    ) -> tuple[Carried, Carried]:
        """(d_vcm, d_vc) after scattering at camera vertex ``depth``; ``d_vcm`` is that of :meth:`joined`. What
        depends on the next vertex is :meth:`left_out`."""
        area, on_edge = self._but_direct(depth, d_vcm, cos)
        total = self._sum(None if self.techniques.waits else area, on_edge, reverse_pdf, d_vc)
        return self._scatter(total, d_vc, cos, pdf, is_delta, 1.0)

    def _but_direct(self, depth: mi.UInt32, d_vcm: Carried, cos: mi.Float) -> tuple[Carried | None, Carried]:
        """Terms of the merge and of the connection before a camera vertex, if the next vertex is on a light."""
        if self.techniques.leaves_direct:
            return None, dr.select(depth == 1, d_vcm * 0.0, d_vcm)
        return self._merge_area(cos, depth), d_vcm

    def nothing_left(self, lanes: int) -> Left | None:
        """What is left out at the sensor; None if nothing ever is."""
        if not self.techniques.waits:
            return None
        used = self.techniques.merge, self.techniques.leaves_direct
        return Left(*(self._start(dr.zeros(mi.Float, lanes)) if on else None for on in used))

    def left_out(self, depth: mi.UInt32, d_vcm: Carried, cos: mi.Float, pdf: mi.Float, is_delta: mi.Bool) -> Left:
        """What :meth:`scatter_camera` left out of d_vc: the merge, and if direct light is left to next event, the
        splat."""
        area, scale = self._merge_area(cos, depth), dr.select(is_delta, 0.0, self.power(cos * dr.rcp(pdf)))
        splat = dr.select(depth == 1, d_vcm, d_vcm * 0.0) * scale if self.techniques.leaves_direct else None
        return Left(None if area is None else area * scale, splat)

    def landed(self, left: Left, cos: mi.Float, passing: Passing | None = None) -> Left:
        """What was left out at the vertex before, after :meth:`passed` and :meth:`hit` with ``cos``."""
        inverse = dr.rcp(self.power(dr.maximum(cos, 1e-8)))

        def land(term: Carried | None) -> Carried | None:
            if term is not None and passing is not None:
                term = self.passed(term, term, passing)[1]
            return None if term is None else term * inverse

        return Left(land(left.merge), land(left.splat))

    def completed(
        self, d_vc: Carried, left: Left | None, pdf: mi.Float | None = None, is_delta: mi.Bool | bool = False
    ) -> Carried:
        """``d_vc`` with what was left out at the vertex before (:meth:`landed`). ``pdf``: density of scattering light
        to that vertex; None: all of its light vertices are merged."""
        if left is not None and left.merge is not None:
            merged = None if pdf is None else self.merged_after(pdf, is_delta)
            d_vc = d_vc + (left.merge if merged is None else left.merge * self.power(merged))
        return d_vc if left is None or left.splat is None else d_vc + left.splat

    def _scatter(
        self, total: Carried, d_vc: Carried, cos: mi.Float, pdf: mi.Float, is_delta: mi.Bool, count: float
    ) -> tuple[Carried, Carried]:
        cos, inverse_pdf = self.power(cos), self.power(dr.rcp(pdf))
        d_vcm = dr.select(is_delta, 0.0, inverse_pdf if self.linear else inverse_pdf * count)
        if self.linear:
            zeros = [dr.zeros(mi.Float, dr.width(d_vcm)) for _ in range(2)]
            d_vcm = Linear(zeros[0], d_vcm, zeros[1])
        return d_vcm, dr.select(is_delta, d_vc * cos, total * (cos * inverse_pdf))

    # ------------------------------------------------------------------ weights, one per radius

    def emission_weight(
        self, depth: mi.UInt32, d_vcm: Carried, d_vc: Carried, area_density: mi.Float, emission_density: mi.Float
    ) -> Weights:
        """Weights of a camera sub-path that hits a light at its vertex ``depth`` [Georgiev 2012b, eq. 43]. ``d_vcm`` is
        unscaled; in the other weights it is that of :meth:`joined`."""
        t = self.techniques
        if not (t.connects and t.emission):
            # Only paths that no other technique samples: lights seen directly or through delta scattering.
            parts = [d_vc.end, d_vc.connection, d_vc.merge] if isinstance(d_vc, Linear) else [d_vc]
            if t.connects:
                parts += [d_vcm.end, d_vcm.connection] if isinstance(d_vcm, Linear) else [d_vcm]
            only = functools.reduce(operator.and_, (part == 0.0 for part in parts))
            return Weights([dr.select((depth == 1) | only, 1.0, 0.0)] * len(self._sets))
        own = self._count(t.emission)
        # Next event along the same edge; at the first vertex the weight is 1.
        edge = d_vcm.connection if isinstance(d_vcm, Linear) else d_vcm
        by_next_event = self.power(area_density) * edge * self._count(t.next_event)
        others = self._at(0.0, d_vc * self.power(emission_density), by_next_event)
        return self._weights(self._own(own), [dr.select(depth == 1, 0.0, other) for other in others])

    def next_event_weight(
        self,
        depth: mi.UInt32,
        d_vcm: Carried,
        d_vc: Carried,
        cos: mi.Float,
        bsdf_pdf: mi.Float,
        reverse_pdf: mi.Float,
        direct_pdf: mi.Float,
        light_ratio: mi.Float,
    ) -> Weights:
        """Weights of a camera vertex connected to a light point [Georgiev 2012b, eq. 44, 45].

        ``cos``: geometric cosine at the vertex; ``bsdf_pdf``: density of scattering towards the light, 0 for a light
        that no ray hits; ``direct_pdf``: solid-angle density of the light point; ``light_ratio``: emission density
        times ``cos`` over (``direct_pdf`` times cosine at the light).
        """
        own = self._count(self.techniques.next_event)
        hit = self.power(bsdf_pdf / direct_pdf) * self._count(self.techniques.emission)
        camera = self._sum(*self._but_direct(depth, d_vcm, cos), reverse_pdf, d_vc)
        return self._weights(self._own(own), self._at(0.0, camera * self.power(light_ratio), hit))

    def connection_weight(
        self,
        depth: mi.UInt32,
        camera: tuple[Carried, Carried],
        light: tuple[Carried, Carried],
        camera_cos: mi.Float,
        light_cos: mi.Float,
        area_pdf_to_light: mi.Float,
        area_pdf_to_camera: mi.Float,
        reverse_pdf_camera: mi.Float,
        reverse_pdf_light: mi.Float,
        light_pdf: mi.Float,
        ratio: mi.Float | None = None,
        merged: mi.Float | None = None,
        there: Mis | None = None,
    ) -> Weights:
        """Weights of the connection of two inner vertices [Georgiev 2012b, eq. 40, 41]. ``camera``, ``light``: their
        (d_vcm, d_vc); ``camera_cos``, ``light_cos``: geometric cosines at which light arrives at them; ``light_pdf``:
        solid-angle density of the light vertex's scattering; ``ratio``: of their edge, see :meth:`chosen`; ``merged``:
        of the light vertex, see :meth:`merged`; ``there``: see :meth:`at`, of the light vertex."""
        eta = (there or self)._merge_area(light_cos, merged=merged)
        by_light = self._sum(eta, light[0], reverse_pdf_light, light[1])
        area = self._merge_area(camera_cos, depth, self.merged_after(light_pdf))
        by_camera = self._sum(area, camera[0], reverse_pdf_camera, camera[1])
        others = self._at(by_light * self.power(area_pdf_to_light), by_camera * self.power(area_pdf_to_camera))
        times = 1.0 if ratio is None else self.power(ratio)
        return self._weights([counts.connection * times for counts in (*self._sets, *self.candidates)], others)

    def splat_weight(
        self,
        d_vcm: Carried,
        d_vc: Carried,
        light_cos: mi.Float,
        reverse_pdf: mi.Float,
        camera_area_pdf: mi.Float,
        merged: mi.Float | None = None,
    ) -> Weights:
        """Weights of a light vertex connected to the camera [Georgiev 2012b, eq. 46, 47]. ``light_cos``: geometric
        cosine at which light arrives at the vertex; ``camera_area_pdf``: area density of the vertex for a camera ray of
        the pixel; ``merged``: see :meth:`merged`."""
        eta = self._merge_area(light_cos, merged=merged) if self.techniques.merge_first else None
        by_light = self._sum(eta, d_vcm, reverse_pdf, d_vc)
        if not self.linear:
            return Weights([dr.rcp(1.0 + by_light * self.power(camera_area_pdf / self.paths_per_sample))])
        others = self._at(by_light * self.power(camera_area_pdf), 0.0)
        return self._weights([counts.splat for counts in (*self._sets, *self.candidates)], others)

    def merge_weight(
        self,
        camera: tuple[Carried, Carried],
        light: tuple[Carried, Carried],
        pdf: mi.Float,
        reverse_pdf: mi.Float,
        merged: mi.Float | None = None,
    ) -> Weights:
        """Weights of a light vertex merged with a camera vertex [Georgiev 2012b, eq. 38, 39].

        ``pdf``, ``reverse_pdf``: densities of the camera vertex's BSDF for the direction that the light arrived from,
        and for the opposite walk; ``merged``: of the light vertex, see :meth:`merged`.
        """
        by_light = self._sum(None, light[0], pdf, light[1])
        by_camera = self._sum(None, camera[0], reverse_pdf, camera[1])
        others = self._at(by_light, by_camera)
        share = self._share if merged is None else self._share * self.power(merged)
        if not self.linear:
            return Weights([dr.rcp(1.0 + others[0] / (self._sets[0].merge * share))])
        return self._weights([counts.merge * share for counts in (*self._sets, *self.candidates)], others)
