"""Emission from other densities of its five random numbers: light, point and direction.

:func:`~etendue.transport.emit` maps uniform numbers u of the unit cube to rays; the throughput is a flux. A scheme
draws u from a density q(u) > 0 instead, and divides the throughput by q. Any tracer of light paths can use a scheme;
the densities of an :class:`EmittedRay`, from which MIS weights are computed, remain those of ``emit``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import Light, LightTable

from .. import dimensions as dim
from ..emission import EmittedRay, emit


class EmissionScheme(Protocol):
    """A way to sample rays from lights."""

    def __call__(self, lights: LightTable, source: SampleSource, active: mi.Bool) -> EmittedRay:
        """A ray of each lane, from the numbers of vertex 0."""
        ...


@dataclass
class GivenNumbers:
    """A :class:`SampleSource` of given numbers of one vertex, by component."""

    numbers: Mapping[int, mi.Float]

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self.numbers[component]

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        return self.numbers[component], self.numbers[component + 1]

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self.numbers[component]


def emit_from(
    lights: LightTable, pick: mi.Float, point: mi.Point2f, direction: mi.Point2f, density: mi.Float, active: mi.Bool
) -> EmittedRay:
    """The ray of given numbers, which were drawn with ``density``."""
    numbers = {
        dim.LIGHT_PICK: pick,
        dim.LIGHT_POINT: point.x,
        dim.LIGHT_POINT + 1: point.y,
        dim.LIGHT_DIRECTION: direction.x,
        dim.LIGHT_DIRECTION + 1: direction.y,
    }
    emitted = emit(lights, GivenNumbers(numbers), active)
    emitted.throughput /= density
    emitted.active &= dr.any(emitted.throughput > 0.0)  # a black light emits nothing to trace
    return emitted


@dataclass(frozen=True)
class UniformLights:
    """All lights equally often, whatever their power."""

    def __call__(self, lights: LightTable, source: SampleSource, active: mi.Bool) -> EmittedRay:
        """See :class:`EmissionScheme`."""
        light, pick = self.pick(lights, source, active)
        point = mi.Point2f(*source.next_2d(0, dim.LIGHT_POINT))
        direction = mi.Point2f(*source.next_2d(0, dim.LIGHT_DIRECTION))
        return emit_from(lights, pick, point, direction, dr.rcp(lights.count * light.emitted), active)

    @staticmethod
    def pick(lights: LightTable, source: SampleSource, active: mi.Bool) -> tuple[Light, mi.Float]:
        """(light, the number that picks it). A light that is known to be black is replaced by another light."""
        u = source.next_1d(0, dim.LIGHT_PICK)
        row = dr.minimum(mi.UInt32(u * lights.count), lights.count - 1)
        return lights.row(row, active), lights.number_of(row, active)


@dataclass(frozen=True)
class BlindEmission:
    """All lights equally often, with directions from area lights uniform over the hemisphere, so that rays spread
    evenly and differ in flux [Leeson 2001, sec. 5.6.4]. Points are uniform already, unless the radiance varies;
    directions of other lights are those of ``emit``."""

    def __call__(self, lights: LightTable, source: SampleSource, active: mi.Bool) -> EmittedRay:
        """See :class:`EmissionScheme`."""
        light, pick = UniformLights.pick(lights, source, active)
        u = mi.Point2f(*source.next_2d(0, dim.LIGHT_DIRECTION))
        # A direction of a surface is a point of the unit disc with 1 - r^2 = cos^(n + 2).
        cos = dr.maximum(1.0 - u.x, 1e-4)
        power = 2.0 if light.exponent is None else light.exponent + 2.0
        radius = dr.safe_sqrt(1.0 - dr.power(cos, power))
        sin, cosine = dr.sincos(2.0 * dr.pi * u.y)
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(radius * cosine, radius * sin))
        square = mi.Point2f(dr.clip(square.x, 0.0, 1.0 - 2.0**-24), dr.clip(square.y, 0.0, 1.0 - 2.0**-24))
        density = dr.select(light.is_area, 0.5 * dr.inv_pi / light.direction_pdf(cos), 1.0)
        direction = dr.select(light.is_area, square, u)
        point = mi.Point2f(*source.next_2d(0, dim.LIGHT_POINT))
        return emit_from(lights, pick, point, direction, density / (lights.count * light.emitted), active)
