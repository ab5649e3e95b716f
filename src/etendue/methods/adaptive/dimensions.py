"""Named random numbers of a path, and sources that warp groups of them by learned densities.

The random numbers of a path are the dimensions of a hypercube [Leeson 2001, sec. 5.4.1]. The user lists groups of
numbers that share a density::

    film; light; bounce1; bounce2          a density each for the point on the film, light points, two directions
    light.pick; light1.u light1.v; lobe    single numbers, of one vertex or of all vertices

A name without an index means all vertices that adapt; they sample independently from one density. Numbers in no group
are those of the sampler. Warped numbers are passed to the path tracer as a ``SampleSource``, so it needs no change.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, SampleSource, suggest
from etendue.integration import AxisBins, CellGrid, DeviceBackend, Factor, PlaneBins, Tabulated, warp_rows
from etendue.transport import dimensions as dim

#: A random number of a path: (vertex, component).
Draw = tuple[int, int]

#: Numbers of vertex 0, the sensor, by name and component.
_ENDS = {
    "film": {"u": dim.FILM, "v": dim.FILM + 1},
    "lens": {"u": dim.APERTURE, "v": dim.APERTURE + 1},
}
#: Numbers of each surface vertex, by name and component.
_VERTICES = {
    "light": {"pick": dim.NEXT_EVENT, "u": dim.NEXT_EVENT + 1, "v": dim.NEXT_EVENT + 2},
    "lobe": {"": dim.LOBE},
    "bounce": {"u": dim.DIRECTION, "v": dim.DIRECTION + 1},
    "roulette": {"": dim.ROULETTE},
}
_LIGHT = tuple(_VERTICES["light"].values())
_WORD = re.compile(r"([a-z]+)(\d*)(?:\.([a-z]+))?")
#: Samples of a pass for each bin, and most bins on an axis of a group of one and two dimensions.
_PER_BIN = 64
_MOST = (256, 48)


@dataclass(frozen=True)
class Group:
    """Random numbers that share a density. ``draws``: for each vertex that samples the density, its numbers."""

    name: str
    draws: tuple[tuple[Draw, ...], ...]

    @property
    def dimension(self) -> int:
        """Dimension of the density."""
        return len(self.draws[0])

    def even(self, bins: int, samples: int) -> Factor:
        """The uniform density with ``bins`` on an axis; 0: a number that suits ``samples``."""
        n = self.dimension
        most = int((DeviceBackend.cells + 0.5) ** (1 / n)) if n > 2 else 4096 if n == 1 else 256
        if bins > most:
            raise OptionError(f"bins must be at most {most} for the group '{self.name}' of {n} dimensions, not {bins}")
        if not bins:
            bins = max(2, min(int((samples / _PER_BIN) ** (1 / n)), _MOST[n - 1] if n < 3 else most))
        return AxisBins.even(bins) if n == 1 else PlaneBins.even(bins) if n == 2 else CellGrid.even(bins, n)


#: The number that samples the number of edges of a path, with ``one_path``.
LENGTH = Group("length", (((0, dim.LENGTH),),))


def groups(text: str, vertices: int, constant: Collection[Draw] = ()) -> list[Group]:
    """The groups in a text. ``vertices``: number of surface points, numbered from 1, whose numbers may be in a group.

    ``constant``: numbers without effect, which are left out; those of vertex 1 stand for all surface points. Raises
    :class:`OptionError` for an unknown name or a number that occurs twice.
    """
    result: list[Group] = []
    seen: set[Draw] = set()
    for part in text.split(";"):
        words = part.replace(",", " ").split()
        if not words:
            continue
        name = " ".join(words)
        draws = _group(words, name, vertices, constant)
        for draw in (d for each in draws for d in each):
            if draw in seen:
                raise OptionError(f"groups: '{name}' has a number that is in another group, too; remove one of them")
            seen.add(draw)
        if draws and draws[0]:
            result.append(Group(name, draws))
    return result


def _group(words: list[str], name: str, vertices: int, constant: Collection[Draw]) -> tuple[tuple[Draw, ...], ...]:
    read = [_read(word) for word in words]
    shared = {vertex is None for vertex, _ in read}
    if len(shared) > 1:
        raise OptionError(f"groups: '{name}' mixes names with and without the number of a vertex; number all or none")
    rows: list[tuple[Draw, ...]] = []
    for number in range(1, vertices + 1) if shared == {True} else (0,):
        row = []
        for vertex, components in read:
            at = number if vertex is None else vertex
            if at > vertices:
                raise OptionError(
                    f"groups: '{name}' is of vertex {at}, but only the first {vertices} adapt (see bounces of vegas)"
                )
            row += [(at, c) for c in components if (min(at, 1), c) not in constant]
        if len(set(row)) < len(row):
            raise OptionError(f"groups: '{name}' has a number twice; remove one of them")
        rows.append(tuple(row))
    return tuple(rows)


def _read(word: str) -> tuple[int | None, list[int]]:
    """(vertex, None for all of them; components) of a name."""
    match = _WORD.fullmatch(word)
    known = _ENDS | _VERTICES
    if match is None or match[1] not in known:
        raise OptionError(f"groups: there is no '{word}'; {suggest(word, known, 'there are')}")
    base, number, component = match.groups()
    if (base in _ENDS and number) or number == "0":
        raise OptionError(
            f"groups: there is no '{word}'; surface points are numbered from 1, and {', '.join(_ENDS)} have no number"
        )
    parts = known[base]
    if component is not None and component not in parts:
        has = f"has the components {' '.join(parts)}" if "" not in parts else "is one number without components"
        raise OptionError(f"groups: there is no '{word}'; {base} {has}")
    vertex = 0 if base in _ENDS else int(number) if number else None
    return vertex, [parts[component]] if component is not None else list(parts.values())


@dataclass
class Drawn:
    """A group's numbers of one vertex, one lane each."""

    group: int  #: number of the group
    weight: mi.Float  #: 1 / density
    bin: mi.UInt32  #: bin of the density, counted over all rows
    walk: int | None  #: first vertex whose scattering uses them; None if only light points do
    lights: tuple[int, ...]  #: vertices whose light points use them

    def used(self, depth: mi.UInt32, by_light_point: bool) -> mi.Bool | bool:
        """Whether a contribution depends on the numbers: that of a hit at the end of edge ``depth``, or that of a light
        point at vertex ``depth``."""
        used: mi.Bool | bool = False if self.walk is None else True if self.walk == 0 else depth > self.walk
        if by_light_point:
            for vertex in self.lights:
                used |= depth == vertex
        return used


class NumberedSource:
    """A :class:`SampleSource` that replaces some numbers by given ones. ``numbers``: (vertex, value) by component."""

    def __init__(self, base: SampleSource, numbers: dict[int, list[tuple[int, mi.Float]]]) -> None:
        self._base, self._numbers = base, numbers
        self.drawn: list[Drawn] = []

    def give(
        self, draws: Sequence[Draw], values: Sequence[mi.Float], left_by_pick: Callable[[mi.Float], mi.Float] | None
    ) -> None:
        """Set the numbers ``draws`` to ``values``. ``left_by_pick``: the function for the remainder of a number that
        selects a light; with it, the first coordinate of a light point also selects the light."""
        for (vertex, component), value in zip(draws, values, strict=True):
            if left_by_pick is not None and component == dim.NEXT_EVENT + 1:
                self._numbers.setdefault(dim.NEXT_EVENT, []).append((vertex, value))
                value = left_by_pick(value)
            self._numbers.setdefault(component, []).append((vertex, value))

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._warped(vertex, component, self._base.next_1d(vertex, component))

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        first, second = self._base.next_2d(vertex, component)
        return self._warped(vertex, component, first), self._warped(vertex, component + 1, second)

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._warped(vertex, component, self._base.decide(vertex, component))

    def _warped(self, vertex: mi.UInt32 | int, component: int, value: mi.Float) -> mi.Float:
        """A number of the base, or the given one. ``vertex``: 0, or an array of numbers from 1."""
        end = isinstance(vertex, int) and vertex == 0
        for at, warped in self._numbers.get(component, ()):
            if (at == 0) == end:
                value = warped if end else dr.select(vertex == at, warped, value)
        return value

    def weight(self, depth: mi.UInt32, by_light_point: bool) -> mi.Float:
        """1 / density of all numbers that a contribution depends on; arguments as of :meth:`Drawn.used`."""
        result: mi.Float = mi.Float(1.0)
        for drawn in self.drawn:
            result = result * dr.select(drawn.used(depth, by_light_point), drawn.weight, 1.0)
        return result

    def counts(self, edges: mi.UInt32) -> mi.Bool | bool:
        """Whether paths of ``edges`` edges contribute."""
        return True

    def goes_on(self, edges: mi.UInt32) -> mi.Bool | bool:
        """Whether paths of more than ``edges`` edges contribute."""
        return True


class AdaptiveSource(NumberedSource):
    """Random numbers of paths, of which those of some groups are warped by densities.

    Parameters
    ----------
    base: the numbers before they are warped.
    groups, factors: the groups, and for each group its densities by row.
    row: the row of densities, one lane a path.
    left_by_pick: see :meth:`NumberedSource.give`.
    """

    def __init__(
        self,
        base: SampleSource,
        groups: Sequence[Group],
        factors: Sequence[Sequence[Tabulated]],
        row: mi.UInt32,
        left_by_pick: Callable[[mi.Float], mi.Float] | None = None,
    ) -> None:
        super().__init__(base, {})
        self.length: mi.UInt32 | None = None  #: edges of the paths that contribute, if this number is sampled
        self.lengths = 0  #: number of lengths; the last one stands for all longer paths
        backend = DeviceBackend(0)
        for number, (group, rows) in enumerate(zip(groups, factors, strict=True)):
            for draws in group.draws:
                u = [self._unwarped(*draw) for draw in draws]
                x, weight, place = warp_rows(backend, rows, u, row)
                if group is LENGTH:
                    self.length, self.lengths = place + 1, rows[0].bins
                    weight = weight * self.lengths
                self.give(draws, x, left_by_pick)
                walk = [vertex for vertex, component in draws if not (vertex and component in _LIGHT)]
                lights = sorted({vertex for vertex, component in draws if vertex and component in _LIGHT})
                place = row * rows[0].bins + place
                self.drawn.append(Drawn(number, weight, place, min(walk, default=None), tuple(lights)))

    def counts(self, edges: mi.UInt32) -> mi.Bool | bool:
        """Whether paths of ``edges`` edges contribute."""
        if self.length is None:
            return True
        return (edges == self.length) | ((self.length == self.lengths) & (edges > self.length))

    def goes_on(self, edges: mi.UInt32) -> mi.Bool | bool:
        """Whether paths of more than ``edges`` edges contribute."""
        return True if self.length is None else (edges < self.length) | (self.length == self.lengths)

    def _unwarped(self, vertex: int, component: int) -> mi.Float:
        """A number of the base, requested as the path tracer requests it."""
        if vertex and component in (dim.LOBE, dim.ROULETTE):
            return self._base.decide(vertex, component)
        if component in ((dim.LENGTH,) if vertex == 0 else (dim.NEXT_EVENT,)):
            return self._base.next_1d(vertex, component)
        pairs = (dim.FILM, dim.APERTURE) if vertex == 0 else (dim.DIRECTION, dim.NEXT_EVENT + 1)
        first = max(pair for pair in pairs if pair <= component)
        return self._base.next_2d(vertex, first)[component - first]


def check_merge(names: str, merge: bool) -> None:
    """Raise :class:`OptionError` if ``names`` has the number that selects a light although ``merge`` is on."""
    if merge and ".pick" in names:
        raise OptionError(f"'{names}': light.pick is part of light.u while merge is on; set merge=false")
