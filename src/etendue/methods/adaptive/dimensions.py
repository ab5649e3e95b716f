"""A path as a point of a hypercube whose dimensions have names, and numbers that a learned density warps.

Every number of a path is a dimension of the hypercube [Leeson 2001, sec. 5.4.1]. The user says which of them adapt, and
which adapt together, by groups in words::

    film; light; bounce1; bounce2          a density each for the point on the film, light points, two directions
    light.pick; light1.u light1.v; lobe    components of them; all vertices alike, or one of them

A name without a number is of every vertex that adapts, which draw independently from one density. What is in no group
keeps the numbers of the sampler it came from. The warped numbers reach the path's integrand through the protocol of
``SampleSource``, so the integrand does not know of any of this.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, SampleSource, suggest
from etendue.integration import AxisBins, CellGrid, DeviceBackend, Factor, PlaneBins, Tabulated, warp_rows
from etendue.transport import dimensions as dim

#: A number of a path: (vertex, component).
Draw = tuple[int, int]

#: Numbers of the film's end of a path.
_ENDS = {
    "film": {"u": dim.FILM, "v": dim.FILM + 1},
    "lens": {"u": dim.APERTURE, "v": dim.APERTURE + 1},
}
#: Numbers of each vertex.
_VERTICES = {
    "light": {"pick": dim.NEXT_EVENT, "u": dim.NEXT_EVENT + 1, "v": dim.NEXT_EVENT + 2},
    "lobe": {"": dim.LOBE},
    "bounce": {"u": dim.DIRECTION, "v": dim.DIRECTION + 1},
    "roulette": {"": dim.ROULETTE},
}
_LIGHT = tuple(_VERTICES["light"].values())
_WORD = re.compile(r"([a-z]+)(\d*)(?:\.([a-z]+))?")
#: Samples that should fall into each bin of a pass, and most bins on an axis of a group of one and two dimensions.
_PER_BIN = 64
_MOST = (256, 48)


@dataclass(frozen=True)
class Group:
    """Dimensions that share a density. ``draws``: once for each vertex that draws from it, what it draws."""

    name: str
    draws: tuple[tuple[Draw, ...], ...]

    @property
    def dimension(self) -> int:
        """Of the density."""
        return len(self.draws[0])

    def even(self, bins: int, samples: int) -> Factor:
        """The uniform density, with ``bins`` to an axis, or for 0 as many as ``samples`` can fill."""
        n = self.dimension
        most = int((DeviceBackend.cells + 0.5) ** (1 / n)) if n > 2 else 4096 if n == 1 else 256
        if bins > most:
            raise OptionError(f"bins of an axis are at most {most} for '{self.name}', {n} dimensions, not {bins}")
        if not bins:
            bins = max(2, min(int((samples / _PER_BIN) ** (1 / n)), _MOST[n - 1] if n < 3 else most))
        return AxisBins.even(bins) if n == 1 else PlaneBins.even(bins) if n == 2 else CellGrid.even(bins, n)


#: How many edges a path has, where one length is drawn.
LENGTH = Group("length", (((0, dim.LENGTH),),))


def groups(text: str, vertices: int, constant: Collection[Draw] = ()) -> list[Group]:
    """The groups that a user's words stand for; of ``vertices`` surface points, numbered from 1, the numbers may adapt.

    ``constant``: numbers that decide nothing and are left out; those of vertex 1 stand for all surface points.
    Raises :class:`OptionError` for words that are no names, or occur twice.
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
                raise OptionError(f"groups: '{name}' has a number that is in a group already; each may be in one")
            seen.add(draw)
        if draws and draws[0]:
            result.append(Group(name, draws))
    return result


def _group(words: list[str], name: str, vertices: int, constant: Collection[Draw]) -> tuple[tuple[Draw, ...], ...]:
    read = [_read(word) for word in words]
    shared = {vertex is None for vertex, _ in read}
    if len(shared) > 1:
        raise OptionError(f"groups: '{name}' joins names with and without the number of a vertex; number all of them")
    rows: list[tuple[Draw, ...]] = []
    for number in range(1, vertices + 1) if shared == {True} else (0,):
        row = []
        for vertex, components in read:
            at = number if vertex is None else vertex
            if at > vertices:
                raise OptionError(f"groups: '{name}' is of vertex {at}, but only {vertices} adapt; raise bounces")
            row += [(at, c) for c in components if (min(at, 1), c) not in constant]
        if len(set(row)) < len(row):
            raise OptionError(f"groups: '{name}' has a number twice; each may be in one group, once")
        rows.append(tuple(row))
    return tuple(rows)


def _read(word: str) -> tuple[int | None, list[int]]:
    """The vertex, None for all of them, and the components that a word names."""
    match = _WORD.fullmatch(word)
    known = _ENDS | _VERTICES
    if match is None or match[1] not in known:
        raise OptionError(f"groups: there is no '{word}'; {suggest(word, known, 'there are')}")
    base, number, component = match.groups()
    if (base in _ENDS and number) or number == "0":
        raise OptionError(
            f"groups: there is no '{word}'; surface points count from 1, and {', '.join(_ENDS)} have no number"
        )
    parts = known[base]
    if component is not None and component not in parts:
        raise OptionError(f"groups: there is no '{word}'; {base} is {' '.join(parts) or 'one number'}")
    vertex = 0 if base in _ENDS else int(number) if number else None
    return vertex, [parts[component]] if component is not None else list(parts.values())


@dataclass
class Drawn:
    """A group's numbers of one vertex, one lane each."""

    group: int  #: number of the group
    weight: Any  #: 1 / density
    bin: Any  #: where they lie: bin of the density, those of all rows counted
    walk: int | None  #: first vertex that the walk leaves by them; None if they are of light points only
    lights: tuple[int, ...]  #: vertices whose light points they are of

    def used(self, depth: Any, by_light_point: bool) -> Any:
        """Whether a contribution depends on them: a hit at the end of edge ``depth``, or a light point joined to vertex
        ``depth``."""
        used: Any = False if self.walk is None else True if self.walk == 0 else depth > self.walk
        if by_light_point:
            for vertex in self.lights:
                used |= depth == vertex
        return used


class NumberedSource:
    """A :class:`SampleSource` some of whose numbers are given: ``numbers`` has vertices and values by component."""

    def __init__(self, base: SampleSource, numbers: dict[int, list[tuple[int, Any]]]) -> None:
        self._base, self._numbers = base, numbers
        self.drawn: list[Drawn] = []

    def give(self, draws: Sequence[Draw], values: Sequence[Any], left_by_pick: Callable[[Any], Any] | None) -> None:
        """Give the numbers ``draws``. With ``left_by_pick``, what a number that picks a light has left, the first
        coordinate of a light point stands for the pick too."""
        for (vertex, component), value in zip(draws, values, strict=True):
            if left_by_pick is not None and component == dim.NEXT_EVENT + 1:
                self._numbers.setdefault(dim.NEXT_EVENT, []).append((vertex, value))
                value = left_by_pick(value)
            self._numbers.setdefault(component, []).append((vertex, value))

    def next_1d(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return self._warped(vertex, component, self._base.next_1d(vertex, component))

    def next_2d(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """See :class:`SampleSource`."""
        first, second = self._base.next_2d(vertex, component)
        return self._warped(vertex, component, first), self._warped(vertex, component + 1, second)

    def decide(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return self._warped(vertex, component, self._base.decide(vertex, component))

    def _warped(self, vertex: Any, component: int, value: Any) -> Any:
        """A number of the base, or the one given in its place. ``vertex`` is 0, or the numbers of vertices from 1."""
        end = isinstance(vertex, int) and vertex == 0
        for at, warped in self._numbers.get(component, ()):
            if (at == 0) == end:
                value = warped if end else dr.select(vertex == at, warped, value)
        return value

    def weight(self, depth: Any, by_light_point: bool) -> Any:
        """1 / density of all numbers that a contribution depends on; the arguments are those of :meth:`Drawn.used`."""
        result: Any = mi.Float(1.0)
        for drawn in self.drawn:
            result = result * dr.select(drawn.used(depth, by_light_point), drawn.weight, 1.0)
        return result

    def counts(self, edges: Any) -> Any:
        """Whether a path of so many edges is one that is looked for."""
        return True

    def goes_on(self, edges: Any) -> Any:
        """Whether one of more edges is."""
        return True


class AdaptiveSource(NumberedSource):
    """Numbers of paths, those of some groups warped by densities.

    Parameters
    ----------
    base: numbers of the hypercube before they are warped.
    groups, factors: the groups, and for each its densities by row.
    row: UInt32 per lane, the row of densities that a lane's numbers are warped by.
    left_by_pick: what a number that picks a light has left, where the first coordinate of the light point is that.
    """

    def __init__(
        self,
        base: SampleSource,
        groups: Sequence[Group],
        factors: Sequence[Sequence[Tabulated]],
        row: Any,
        left_by_pick: Callable[[Any], Any] | None = None,
    ) -> None:
        super().__init__(base, {})
        self.length: Any = None  #: edges of the path that counts, where one length is drawn
        self.lengths = 0  #: how many lengths there are; the last one stands for all that are longer
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

    def counts(self, edges: Any) -> Any:
        """Whether a path of so many edges is the one that is looked for."""
        if self.length is None:
            return True
        return (edges == self.length) | ((self.length == self.lengths) & (edges > self.length))

    def goes_on(self, edges: Any) -> Any:
        """Whether one of more edges is."""
        return True if self.length is None else (edges < self.length) | (self.length == self.lengths)

    def _unwarped(self, vertex: int, component: int) -> Any:
        """A number of the base, drawn as the integrand draws it."""
        if vertex and component in (dim.LOBE, dim.ROULETTE):
            return self._base.decide(vertex, component)
        if component in ((dim.LENGTH,) if vertex == 0 else (dim.NEXT_EVENT,)):
            return self._base.next_1d(vertex, component)
        pairs = (dim.FILM, dim.APERTURE) if vertex == 0 else (dim.DIRECTION, dim.NEXT_EVENT + 1)
        first = max(pair for pair in pairs if pair <= component)
        return self._base.next_2d(vertex, first)[component - first]


def check_merge(names: str, merge: bool) -> None:
    """Raise :class:`OptionError` if ``names`` has the number that picks a light though it is merged with another."""
    if merge and ".pick" in names:
        raise OptionError(f"'{names}': light.pick is a part of light.u while merge is on; set merge to false")
