"""Multiple importance sampling over all techniques of a path, carried along each sub-path in two numbers.

A path with k edges can be made by hitting the light (emission), by next event, by connecting two inner vertices, by
connecting a light sub-path to the camera (splat), and by merging at any inner vertex. The weight of technique i is
``(n_i p_i)^beta / sum_j (n_j p_j)^beta`` [Veach 1997, eq. 9.8; Georgiev 2012, eq. 7]; its denominator is assembled
from one running pair per sub-path, so it costs O(1) per vertex [Georgiev 2012b, sec. 4]. The report's quantities are
dVCM, dVC and dVM; here

- ``d_vcm`` is the report's dVCM times the sample count of the technique that it stands for, and
- ``d_vc`` holds dVC; with merging but no connections it holds ``eta_vm * dVM``. The report's dVM is never stored:
  with both it equals dVC / eta_vm [Georgiev 2012b, eq. 20 in 35 and 36].

Sample counts enter where a technique enters, so any set of techniques, each with any count, gives weights that sum to
one: a count of zero removes the technique, from the estimator and from the weights alike. Cosines in here are those of
the geometric normal. Russian roulette is left out of every density; that costs no bias, as the weights of a path stay
the same whichever technique makes it.

Merging divides by the cosine at which light reached a photon's surface, and near zero the quotient has no bound. A
vertex where it is below :data:`GRAZING` is therefore no place to merge at, in the estimator and in the weights, as long
as there are techniques that connect; merging alone bounds the quotient (:meth:`Mis.fluence`).

With several merging radii at once the pair is a triple: d_vc is linear in eta_vm, so its two coefficients are carried
instead (:class:`RadiusFree`), and a weight is a number for each radius.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

#: Least geometric cosine that merging divides by.
GRAZING = 0.02


@dataclass(frozen=True)
class Techniques:
    """How many samples each technique takes per camera path (zero: not used) and the heuristic's exponent."""

    emission: int = 1  #: the camera sub-path hits a light (s = 0)
    next_event: int = 1  #: a camera vertex is joined to a fresh light point (s = 1)
    connection: int = 1  #: a camera vertex is joined to stored light vertices (s >= 2, t >= 2)
    splat: bool = True  #: a light vertex is joined to the camera (t = 1)
    merge: bool = True  #: a camera vertex gathers light vertices around it
    merge_first: bool = True  #: merging at the first camera vertex too
    beta: int = 1  #: 1 balance heuristic, 2 power heuristic

    @property
    def connects(self) -> bool:
        """Whether any technique joins two vertices by an edge (the report's VC family)."""
        return bool(self.next_event or self.connection or self.splat)


@dataclass
class RadiusFree:
    """``a + b eta`` of an eta that is filled in last. A product or sum with a number has this on its left."""

    a: Any
    b: Any

    def __add__(self, other: Any) -> RadiusFree:
        if isinstance(other, RadiusFree):
            return RadiusFree(self.a + other.a, self.b + other.b)
        return RadiusFree(self.a + other, self.b)

    def __mul__(self, factor: Any) -> RadiusFree:
        return RadiusFree(self.a * factor, self.b * factor)

    def at(self, eta: Any) -> Any:
        """Its value."""
        return self.a + self.b * eta


class Mis:
    """The recursion and the weights for one set of techniques. Every weight is a list: one a merging radius.

    Parameters
    ----------
    techniques: the sample counts.
    eta_vm: merging's sample count times the acceptance area, n_VM pi r^2 [Georgiev 2012b, eq. 20], of each radius; may
        be opaque scalars, as they shrink from pass to pass. Ignored if merging is off.
    paths_per_sample: light sub-paths per camera path of one pixel, n_LP (a splat reaches every pixel).
    """

    def __init__(self, techniques: Techniques, eta_vm: Sequence[Any], paths_per_sample: Any) -> None:
        self.techniques = techniques
        self.paths_per_sample = paths_per_sample
        self._etas = [self.power(eta) for eta in eta_vm] if techniques.merge else [0.0]
        #: What the recursion adds where a sub-path may merge.
        self._eta: Any = RadiusFree(0.0, 1.0) if self.radius_free else self._etas[0]

    @property
    def radius_free(self) -> bool:
        """Whether d_vc is a :class:`RadiusFree`, there being several radii, or a number."""
        return len(self._etas) > 1

    def power(self, x: Any) -> Any:
        """``x^beta``."""
        return x * x if self.techniques.beta == 2 else x

    def _count(self, n: int) -> float:
        return float(n**self.techniques.beta)

    def _start(self, d_vc: Any) -> Any:
        return RadiusFree(d_vc, dr.zeros(mi.Float, dr.width(d_vc))) if self.radius_free else d_vc

    def _at_radii(self, value: Any) -> list[Any]:
        """A sum of the recursion, for each radius."""
        return [value.at(eta) for eta in self._etas] if isinstance(value, RadiusFree) else [value] * len(self._etas)

    # ------------------------------------------------------------------ light sub-path

    def start_light(self, area_density: Any, emission_density: Any, cos_light: Any, is_delta: Any) -> tuple[Any, Any]:
        """(d_vcm, d_vc) of an emitted ray [Georgiev 2012b, eq. 31, 32].

        ``area_density``: density of the light point under next event (of the direction, for an infinite light), and
        ``emission_density``: of point and direction together; both include the picking probability. Where the first
        depends on the point that is lit, any number stands for it until :meth:`lit` knows that point.
        """
        t = self.techniques
        d_vcm = self.power(area_density / emission_density) * self._count(t.next_event)
        emission = self._count(t.emission) if t.connects else 0.0
        d_vc = dr.select(is_delta, 0.0, self.power(cos_light / emission_density) * emission)
        return d_vcm, self._start(d_vc)

    def lit(self, d_vcm: Any, ratio: Any) -> Any:
        """``d_vcm`` of an emitted ray that has met x_1; ``ratio``: density p(x_0 | x_1) of the light point under next
        event, over the ``area_density`` that the sub-path was started with. Before :meth:`hit`.

        Only d_vcm holds that density [Georgiev 2012b, eq. 31]: the techniques that d_vc stands for begin by emission.
        """
        return d_vcm * self.power(ratio)

    # ------------------------------------------------------------------ camera sub-path

    def start_camera(self, pixel_density: Any) -> tuple[Any, Any]:
        """(d_vcm, d_vc) of a camera ray; ``pixel_density`` is its solid-angle density for a point uniform in its pixel.
        Zero density (a direction the sensor can't be splatted from) leaves the splat out [eq. 31]."""
        ok = (pixel_density > 0.0) & self.techniques.splat
        d_vcm = dr.select(ok, self.power(self.paths_per_sample / dr.select(ok, pixel_density, 1.0)), 0.0)
        return d_vcm, self._start(dr.zeros(mi.Float, dr.width(d_vcm)))

    # ------------------------------------------------------------------ both

    def hit(self, d_vcm: Any, d_vc: Any, distance_squared: Any, cos: Any) -> tuple[Any, Any]:
        """Solid angle to area at the surface just reached; ``cos`` = \\|cos\\| there."""
        inverse = dr.rcp(self.power(dr.maximum(cos, 1e-8)))  # a ray along the surface: 0 * inf is no weight
        return d_vcm * self.power(distance_squared) * inverse, d_vc * inverse

    def joined(self, depth: Any, d_vcm: Any) -> Any:
        """``d_vcm`` of a camera vertex as the count of the technique that cuts the edge before it: a splat at the first
        vertex, a connection after (kept unscaled by the walk, as emission weighs the same edge as next event)."""
        count = self._count(self.techniques.connection)
        return d_vcm if count == 1.0 else d_vcm * dr.select(depth == 1, 1.0, count)

    def fluence(self, cos: Any) -> Any:
        """Fluence of light of unit flux per area that reaches a surface at this geometric cosine, 1 / cos, for
        merging; 0 where a vertex is no place to merge at."""
        bounded = dr.rcp(dr.maximum(cos, GRAZING))
        return dr.select(cos >= GRAZING, bounded, 0.0) if self.techniques.connects else bounded

    def _merge_area(self, cos: Any, depth: Any = None) -> Any:
        """``eta_vm`` where a vertex may merge that light reaches at this geometric cosine, else 0; ``depth``: of a
        camera vertex."""
        t = self.techniques
        if not t.merge:
            return self._eta
        may = self.fluence(cos) > 0.0
        if depth is not None and not t.merge_first:
            may &= depth != 1
        return self._eta * dr.select(may, mi.Float(1.0), mi.Float(0.0))

    def _sum(self, eta: Any, d_vcm: Any, reverse_pdf: Any, d_vc: Any) -> Any:
        """Techniques that cut the sub-path at its end vertex or before, over the density of reaching it."""
        before = d_vc * self.power(reverse_pdf)
        return before + d_vcm + eta if self.techniques.connects else before + eta

    def scatter_light(
        self, d_vcm: Any, d_vc: Any, light_cos: Any, cos: Any, pdf: Any, reverse_pdf: Any, is_delta: Any
    ) -> Any:
        """(d_vcm, d_vc) after scattering at a light vertex [Georgiev 2012b, eq. 34, 35; delta: 53, 54]; ``light_cos``:
        of the direction it was reached from, ``cos``: of the one it is left in."""
        total = self._sum(self._merge_area(light_cos), d_vcm, reverse_pdf, d_vc)
        return self._scatter(total, d_vc, cos, pdf, is_delta, self._count(self.techniques.connection))

    def scatter_camera(
        self, depth: Any, d_vcm: Any, d_vc: Any, cos: Any, pdf: Any, reverse_pdf: Any, is_delta: Any
    ) -> Any:
        """(d_vcm, d_vc) after scattering at camera vertex ``depth``; d_vcm stays unscaled (see :meth:`joined`)."""
        total = self._sum(self._merge_area(cos, depth), self.joined(depth, d_vcm), reverse_pdf, d_vc)
        return self._scatter(total, d_vc, cos, pdf, is_delta, 1.0)

    def _scatter(self, total: Any, d_vc: Any, cos: Any, pdf: Any, is_delta: Any, count: float) -> tuple[Any, Any]:
        cos, inverse_pdf = self.power(cos), self.power(dr.rcp(pdf))
        return (
            dr.select(is_delta, 0.0, inverse_pdf * count),
            dr.select(is_delta, d_vc * cos, total * (cos * inverse_pdf)),
        )

    # ------------------------------------------------------------------ weights, one a radius

    def emission_weight(self, depth: Any, d_vcm: Any, d_vc: Any, area_density: Any, emission_density: Any) -> list[Any]:
        """The camera sub-path hit a light at its vertex ``depth`` [Georgiev 2012b, eq. 43]."""
        t = self.techniques
        if not (t.connects and t.emission):
            # Only what nothing else can make: seen directly, or through vertices that no other technique may cut.
            uncut = (d_vc.a == 0.0) & (d_vc.b == 0.0) if self.radius_free else d_vc == 0.0
            if t.connects:
                uncut &= d_vcm == 0.0
            return self._at_radii(dr.select((depth == 1) | uncut, 1.0, 0.0))
        own = self._count(t.emission)
        by_next_event = self.power(area_density) * d_vcm * self._count(t.next_event)
        others = self._at_radii(d_vc * self.power(emission_density) + by_next_event)
        return [dr.select(depth == 1, 1.0, own / (own + other)) for other in others]

    def next_event_weight(
        self,
        depth: Any,
        d_vcm: Any,
        d_vc: Any,
        cos: Any,
        bsdf_pdf: Any,
        reverse_pdf: Any,
        direct_pdf: Any,
        light_ratio: Any,
    ) -> list[Any]:
        """A camera vertex joined to a light point, at a geometric cosine ``cos`` [Georgiev 2012b, eq. 44, 45].

        ``bsdf_pdf``: of scattering towards the light (0 for a light that no ray hits); ``direct_pdf``: solid-angle
        density of the light point; ``light_ratio``: emission density times cos at the vertex over ``direct_pdf`` times
        cos at the light.
        """
        own = self._count(self.techniques.next_event)
        hit = self.power(bsdf_pdf / direct_pdf) * self._count(self.techniques.emission)
        camera = self._sum(self._merge_area(cos, depth), self.joined(depth, d_vcm), reverse_pdf, d_vc)
        others = camera * self.power(light_ratio) + hit
        return [own / (own + other) for other in self._at_radii(others)]

    def connection_weight(
        self,
        depth: Any,
        camera: tuple[Any, Any],
        light: tuple[Any, Any],
        camera_cos: Any,
        light_cos: Any,
        area_pdf_to_light: Any,
        area_pdf_to_camera: Any,
        reverse_pdf_camera: Any,
        reverse_pdf_light: Any,
    ) -> list[Any]:
        """Two inner vertices joined; ``camera`` and ``light`` are their (d_vcm, d_vc), ``camera_cos`` and ``light_cos``
        the cosines at which light reaches them [Georgiev 2012b, eq. 40, 41]."""
        own = self._count(self.techniques.connection)
        by_light = self._sum(self._merge_area(light_cos), light[0], reverse_pdf_light, light[1])
        area = self._merge_area(camera_cos, depth)
        by_camera = self._sum(area, self.joined(depth, camera[0]), reverse_pdf_camera, camera[1])
        others = by_light * self.power(area_pdf_to_light) + by_camera * self.power(area_pdf_to_camera)
        return [own / (own + other) for other in self._at_radii(others)]

    def splat_weight(self, d_vcm: Any, d_vc: Any, light_cos: Any, reverse_pdf: Any, camera_area_pdf: Any) -> list[Any]:
        """A light vertex joined to the camera; ``light_cos``: at which light reaches it, ``camera_area_pdf``: area
        density with which the pixel's camera ray does [Georgiev 2012b, eq. 46, 47]."""
        eta = self._merge_area(light_cos) if self.techniques.merge_first else 0.0
        others = self._sum(eta, d_vcm, reverse_pdf, d_vc) * self.power(camera_area_pdf / self.paths_per_sample)
        return [dr.rcp(1.0 + other) for other in self._at_radii(others)]

    def merge_weight(
        self, depth: Any, camera: tuple[Any, Any], light: tuple[Any, Any], pdf: Any, reverse_pdf: Any
    ) -> list[Any]:
        """A light vertex merged into a camera vertex [Georgiev 2012b, eq. 38, 39].

        ``pdf``: of the camera vertex's BSDF towards where the light came from; ``reverse_pdf``: the other way.
        """
        by_light = self._sum(0.0, light[0], pdf, light[1])
        others = by_light + self._sum(0.0, self.joined(depth, camera[0]), reverse_pdf, camera[1])
        return [dr.rcp(1.0 + other / eta) for other, eta in zip(self._at_radii(others), self._etas, strict=True)]
