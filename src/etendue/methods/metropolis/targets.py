"""Functions of the random numbers of a path, for chains: what a path contributes to the film, and where."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, SampleSource
from etendue.integration import Layout, Slot
from etendue.scene import Packet, is_rgb, is_spectral
from etendue.transport import CameraPath, DirectWeights, Walker, dimensions as dim

from ..base import ImageMethod, keep_finite
from ..path import traced

#: Longest expected stay of a chain at one path, in large steps; if few samples find light, the second number over
#: their share.
CAP, _LIT_CAP = 100.0, 10.0


@dataclass
class Contribution:
    """A contribution to the film, one lane a path."""

    position: mi.Point2f  #: on the film, in pixels
    value: mi.Color3f  #: as the radiance of a camera path that is uniform on the film; 0 where there is none
    component: int = 0  #: ``film.Component``, the same in all lanes; 0 where components are not kept apart

    def where(self, mask: mi.Bool, other: Contribution) -> Contribution:
        """This contribution where the mask holds, elsewhere another one of the same component."""
        position, value = dr.select(mask, self.position, other.position), dr.select(mask, self.value, other.value)
        return Contribution(position, value, self.component)


@dataclass
class Traced:
    """The contributions of one path a lane, not yet evaluated."""

    contributions: list[Contribution]
    rays: mi.UInt32
    nonfinite: mi.UInt32  #: contributions that were not finite and are 0
    wanted: mi.UInt32 | None = None  #: the room that a store of vertices needs, one number


class Target(Protocol):
    """A function of primary samples. Its integral over the unit cube is a picture: the mean of the contributions'
    values over uniform numbers is the mean of the picture."""

    #: The numbers of each sub-path that a chain keeps, by name.
    layouts: Mapping[str, Layout]

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """Trace a path in each lane, with the numbers of ``sources``, one for each of ``layouts``. A function of these
        numbers only: the count of the contributions is always the same, and no other number is used."""
        ...

    def reads(self) -> Sequence[object]:
        """The objects with the device arrays that :meth:`trace` reads, for ``core.Frozen``."""
        ...

    def had_room(self, wanted: int, lanes: int) -> bool:
        """Whether the store had the room that was ``wanted``; if not, there is more now, and the paths must be traced
        again."""
        ...


def largest_target(targets: Array) -> float:
    """The ``cap`` of a target with given values: the largest with which a large step from any path is accepted with a
    probability of at least 1 / ``CAP``, or a tenth of the share of values above 0 if that is less. It solves ``cap = c
    mean(min(target, cap))``, c being the inverse of that probability.
    """
    values = np.sort(targets, axis=None)
    count = len(values)
    longest = max(CAP, _LIT_CAP * count / max(int(np.count_nonzero(values)), 1))
    below = np.cumsum(values)
    above = np.arange(count - 1, -1, -1)  # number of values behind each
    # The difference of the two sides is concave in cap, and positive near 0.
    last = np.flatnonzero(longest * (below + above * values) >= count * values)[-1]
    return float(longest * below[last] / (count - longest * above[last]))


def brightness(value: mi.Color3f) -> mi.Float:
    """What chains sample: luminance; under spectral variants the mean of all channels, since a path of few wavelengths
    may have a colour of no luminance."""
    return dr.maximum(mi.luminance(value), 0.0) if is_rgb() else dr.mean(dr.abs(value))


def wavelengths_of(method: ImageMethod, source: SampleSource) -> AbstractContextManager[None]:
    """The block in which paths are traced, with the wavelengths that ``source`` draws."""
    return method.packet.drawn(source.next_1d(0, dim.WAVELENGTHS) if is_spectral() else None)


def film_place(method: ImageMethod, source: SampleSource) -> mi.Point2f:
    """A film position in pixels, uniform over the film."""
    u = source.next_2d(0, dim.FILM)
    return mi.Point2f(u[0] * method.camera.width, u[1] * method.camera.height)


def camera_slots(method: ImageMethod) -> tuple[list[Slot], list[Slot]]:
    """The numbers of a camera sub-path that have an effect in the prepared scene: of vertex 0, and of each other."""
    lens = [Slot(dim.APERTURE, 2)] if method.camera.sensor.needs_aperture_sample() else []
    pick = [Slot(dim.NEXT_EVENT)] if method.lights.count > 1 else []
    inner = [Slot(dim.LOBE, decided=True), Slot(dim.DIRECTION, 2), *pick, Slot(dim.NEXT_EVENT + 1, 2)]
    return [Slot(dim.FILM, 2), *lens, *_wavelengths()], inner


def light_slots(method: ImageMethod) -> tuple[list[Slot], list[Slot]]:
    """As :func:`camera_slots`, of a light sub-path; the aperture sample of a splat is that of vertex 1."""
    pick = [Slot(dim.LIGHT_PICK)] if method.lights.count > 1 else []
    lens = [Slot(dim.SPLAT_APERTURE, 2)] if method.camera.sensor.needs_aperture_sample() else []
    end = [*pick, Slot(dim.LIGHT_POINT, 2), Slot(dim.LIGHT_DIRECTION, 2), *_wavelengths()]
    return end, [Slot(dim.LOBE, decided=True), Slot(dim.DIRECTION, 2), *lens]


def _wavelengths() -> list[Slot]:
    return [Slot(dim.WAVELENGTHS)] if is_spectral() else []


ROULETTE = Slot(dim.ROULETTE, decided=True)


def found_by(packet: Packet, path: CameraPath, place: mi.Point2f) -> tuple[list[Contribution], mi.Bool]:
    """(contributions of camera paths: one, or one for each component; mask of lanes that are not finite and 0)."""
    radiance, bad = keep_finite(packet.rgb(path.radiance))
    if not path.by_component:
        return [Contribution(place, radiance)], bad
    parts = enumerate(map(packet.rgb, path.by_component))
    return [Contribution(place, dr.select(bad, 0.0, part), number) for number, part in parts], bad


class PathTarget:
    """A camera path with next event estimation and multiple importance sampling, as of ``path``. A vertex has 6
    numbers, 7 in a scene with several lights."""

    def __init__(self, method: ImageMethod, vertices: int) -> None:
        self._method: ImageMethod = weakref.proxy(method)  # which owns the target
        end, inner = camera_slots(method)
        self.layouts: Mapping[str, Layout] = {"camera": Layout(end, [*inner, ROULETTE], vertices)}

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """See :class:`Target`."""
        method, source = self._method, sources["camera"]
        place = film_place(method, source)
        with wavelengths_of(method, source):
            ray, importance, _ = method.camera.through(place, source)
            walker = method.walker(Walker, proposal=method.settings.proposal)
            path = traced(ray, walker, DirectWeights(), source, **method.path_fields())
            path.weigh(importance)
            contributions, bad = found_by(method.packet, path, place)
        return Traced(contributions, path.rays, dr.select(bad, mi.UInt32(1), 0))

    def reads(self) -> Sequence[object]:
        """See :class:`Target`."""
        return self._method.tables()

    def had_room(self, wanted: int, lanes: int) -> bool:
        """See :class:`Target`."""
        return True
