"""Random numbers of the paths of image methods, by the setting ``sampler``."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import IndependentSource, SampleSource
from etendue.points import Coordinates, OwenSobolSource, RadicalSource
from etendue.transport import dimensions as dim

_WORD = 0xFFFFFFFF


@dataclass(frozen=True)
class Lanes:
    """A range of the lanes of a pass, whose numbers may exceed 2^32."""

    first: int
    count: int

    def part(self, index: int, parts: int) -> Lanes:
        """Part ``index`` of ``parts`` nearly equal ones."""
        first, end = self.count * index // parts, self.count * (index + 1) // parts
        return Lanes(self.first + first, end - first)

    def numbers(self, offset: int = 0) -> tuple[mi.UInt32, mi.UInt32]:
        """(lower words, upper words) of ``offset`` plus the number of each lane."""
        return places(dr.arange(mi.UInt32, self.count), offset + self.first)


def camera_numbers(
    sampler: str,
    scrambling: str,
    pixel: mi.UInt32,
    number: mi.UInt32,
    samples: int,
    seed: int,
    iteration: int,
    role: str,
) -> SampleSource:
    """Stratified random numbers of camera paths; ``number``: of a path among the ``samples`` of its pixel in a pass."""
    index, high = places(number, 0 if sampler == "hammersley" else iteration * samples)
    if sampler == "owen":
        return OwenSobolSource(pixel, index, seed, role, high)
    pixel = mi.UInt32(0) if scrambling == "same" else pixel
    return _radical(dim.CAMERA_COORDINATES, sampler, scrambling, pixel, index, high, samples, seed, iteration, role)


def light_numbers(
    sampler: str,
    lanes: Lanes,
    paths: int,
    seed: int,
    iteration: int,
    role: str = "light",
    scrambling: str = "digits",
) -> SampleSource:
    """Random numbers of the light paths ``lanes``; ``paths``: all light paths of a pass."""
    number = dr.arange(mi.UInt32, lanes.count)
    return path_numbers(sampler, number, paths, seed, iteration, role, scrambling, lanes.first)


def path_numbers(
    sampler: str,
    number: mi.UInt32,
    paths: int,
    seed: int,
    iteration: int,
    role: str = "light",
    scrambling: str = "digits",
    first: int = 0,
) -> SampleSource:
    """Random numbers of the light paths ``first + number``, one lane each."""
    if sampler == "independent":
        lane, high = places(number, first)
        return IndependentSource(lane, seed, role, iteration, high)
    index, high = places(number, first + (0 if sampler == "hammersley" else iteration * paths))
    sequence = dr.zeros(mi.UInt32)
    if sampler == "owen":
        return OwenSobolSource(sequence, index, seed, role, high)
    return _radical(dim.LIGHT_COORDINATES, sampler, scrambling, sequence, index, high, paths, seed, iteration, role)


def _radical(
    coordinates: Coordinates,
    sampler: str,
    scrambling: str,
    sequence: mi.UInt32,
    index: mi.UInt32,
    high: mi.UInt32,
    size: int,
    seed: int,
    iteration: int,
    role: str,
) -> RadicalSource:
    """Halton's sequence, which continues from pass to pass, or Hammersley's ``size`` points, new ones in each pass."""
    new = sampler == "hammersley"
    return RadicalSource(
        sequence,
        index,
        seed,
        role,
        coordinates,
        high=high,
        iteration=iteration if new else 0,
        digits=scrambling == "digits",
        size=size if new else None,
    )


class SharedFilm:
    """Random numbers of camera paths, with a separate source for the offset in the pixel."""

    def __init__(self, base: SampleSource, film: SampleSource) -> None:
        self._base, self._film = base, film

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._base.next_1d(vertex, component)

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        on_film = isinstance(vertex, int) and vertex == 0 and component == dim.FILM
        return (self._film if on_film else self._base).next_2d(vertex, component)

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._base.decide(vertex, component)


def places(number: mi.UInt32, first: int) -> tuple[mi.UInt32, mi.UInt32]:
    """(lower word, upper word) of ``first`` plus a number."""
    start = dr.opaque(mi.UInt32, first & _WORD)
    lower = start + number
    carry = dr.select(lower < start, mi.UInt32(1), mi.UInt32(0))
    return lower, dr.opaque(mi.UInt32, (first >> 32) & _WORD) + carry
