"""Markov chains over the random numbers of a path: primary samples [Kelemen 2002].

The state of a chain is a point of the unit cube, the random numbers that a path tracer asks for by vertex and
component. A :class:`PrimarySource` answers with the numbers of a *proposal*, without storing them:

- a **large step** takes fresh numbers, independent of the state;
- a **small step** moves each number of the state by a symmetric distance, modulo 1.

Both leave the uniform distribution of the cube unchanged. Numbers without a place in the :class:`Layout`, and those of
vertices beyond its last one, are fresh at every step. State and fresh numbers together are a point of a larger cube, in
which the fresh coordinates always move independently. The chain stays exact although these are not stored, because the
value of the target at the current state is stored [Andrieu 2009].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr

from etendue.core import SampleSource

#: Ratio of the largest distance of a small step to the smallest [Kelemen 2002, sec. 4].
STEP_RATIO = 64.0
#: The largest number below 1 in single precision.
_BELOW_ONE = 1.0 - 2.0**-24


@dataclass(frozen=True)
class Slot:
    """One number of a vertex, or two that belong together: ``component`` and ``component + 1``."""

    component: int
    numbers: int = 1
    decided: bool = False  #: requested by ``decide``, without stratification
    still: bool = False  #: unchanged by small steps


@dataclass(frozen=True)
class _Place:
    slot: Slot
    index: int  #: of the number in its slot
    row: int  #: row of this number of the first vertex; later vertices follow
    vertices: int


class Layout:
    """Rows of the state of a chain, one for each number of a sub-path.

    Parameters
    ----------
    end: the numbers of vertex 0.
    inner: the numbers of each of the vertices 1 to ``vertices``.
    """

    def __init__(self, end: Sequence[Slot], inner: Sequence[Slot], vertices: int) -> None:
        self._places: dict[tuple[bool, int], _Place] = {}
        self.size = 0
        for is_end, slots in ((True, end), (False, inner)):
            count = 1 if is_end else vertices
            for slot in slots if count else ():
                for index in range(slot.numbers):
                    self._places[is_end, slot.component + index] = _Place(slot, index, self.size, count)
                    self.size += count

    def find(self, at_end: bool, component: int) -> _Place | None:
        """The place of a number, or ``None``."""
        return self._places.get((at_end, component))

    def firsts(self) -> list[tuple[bool, _Place]]:
        """(whether the slot belongs to vertex 0, place) of the first number of each slot."""
        return [(end, place) for (end, _), place in self._places.items() if place.index == 0]


def moved(x: dr.ArrayBase, u: dr.ArrayBase, size: dr.ArrayBase | float) -> dr.ArrayBase:
    """``x`` moved in either direction, modulo 1, by a distance between ``size / STEP_RATIO`` and ``size`` whose
    logarithm is uniform [Kelemen 2002, sec. 4]. ``u``: uniform in [0, 1)."""
    v = 2.0 * u - 1.0
    y = x + dr.copysign(size * dr.exp(-math.log(STEP_RATIO) * dr.abs(v)), v)
    return dr.minimum(y - dr.floor(y), _BELOW_ONE)


@dataclass
class Move:
    """A step of all chains.

    ``fresh``: returns the source of fresh numbers for chains given by their numbers; ``size``: the largest distance of
    a small step, an opaque scalar; ``None``: a large step.
    """

    fresh: Callable[[dr.ArrayBase], SampleSource]
    size: dr.ArrayBase | None = None

    def source(self, layout: Layout, state: dr.ArrayBase | None, chain: dr.ArrayBase, chains: int) -> PrimarySource:
        """The proposals of the chains numbered ``chain``, one lane each; ``chains``: number of all chains."""
        return PrimarySource(layout, self.fresh(chain), chain, chains, state, self.size)

    def write(
        self,
        layout: Layout,
        state: dr.ArrayBase,
        accepted: dr.ArrayBase | None,
        chain: dr.ArrayBase,
        chains: int,
        at: dr.ArrayBase | None = None,
    ) -> dr.ArrayBase:
        """The state of all chains after the step: the proposal where it is ``accepted``, everywhere if ``None``.
        ``chain``: the numbers of the chains for ``fresh``. ``at`` restricts a large step to the chains with these
        indices in the state; ``chain`` then has their numbers only. The given state is not changed."""
        result = type(state)(state)
        # Opaque if it varies between calls; otherwise it would be compiled into the kernels.
        count = chains if at is None else dr.opaque(type(chain), dr.width(chain))
        for end, place in layout.firsts():
            lane = dr.arange(type(chain), place.vertices * dr.width(chain))
            row = lane // count
            number = lane - row * count
            own = dr.gather(type(chain), chain, number)
            source = PrimarySource(layout, self.fresh(own), number, chains, state, self.size)
            mask = True if accepted is None else dr.gather(type(accepted), accepted, number)
            goal = row * chains + (number if at is None else dr.gather(type(chain), at, number))
            for index, value in enumerate(source.values(0 if end else row + 1, place.slot)):
                dr.scatter(result, value, goal + (place.row + index * place.vertices) * chains, mask)
        dr.eval(result)
        return result


class PrimarySource:
    """A :class:`SampleSource` of the numbers of a proposal, which depend on its arguments only.

    Parameters
    ----------
    layout: the rows of the state.
    fresh: fresh numbers for the lanes.
    chain: index of the chain of each lane; ``chains``: number of all chains.
    state: row by row, ``chains`` numbers each.
    size: largest distance of a small step; ``None``: a large step, for which the state is not read.
    """

    def __init__(
        self,
        layout: Layout,
        fresh: SampleSource,
        chain: dr.ArrayBase,
        chains: int,
        state: dr.ArrayBase | None,
        size: dr.ArrayBase | None,
    ) -> None:
        self._layout, self._fresh = layout, fresh
        self._chain, self._chains = chain, chains
        self._state, self._size = state, size

    def values(self, vertex: dr.ArrayBase | int, slot: Slot) -> tuple[dr.ArrayBase, ...]:
        """The numbers of a slot."""
        fresh: tuple[dr.ArrayBase, ...]
        if slot.numbers == 2:
            fresh = self._fresh.next_2d(vertex, slot.component)
        else:
            number = self._fresh.decide if slot.decided else self._fresh.next_1d
            fresh = (number(vertex, slot.component),)
        return tuple(self._proposed(vertex, slot.component + i, u) for i, u in enumerate(fresh))

    def _proposed(self, vertex: dr.ArrayBase | int, component: int, fresh: dr.ArrayBase) -> dr.ArrayBase:
        end = isinstance(vertex, int) and vertex == 0
        place = self._layout.find(end, component)
        if place is None or self._size is None:
            return fresh
        row = type(self._chain)(place.row) if end else type(self._chain)(vertex) + (place.row - 1)
        stored = dr.mask_t(self._chain)(True) if end else vertex <= place.vertices
        old = dr.gather(type(self._state), self._state, row * self._chains + self._chain, stored)
        new = old if place.slot.still else moved(old, fresh, self._size)
        return dr.select(stored, new, fresh)

    def _one(self, vertex: dr.ArrayBase | int, component: int, decided: bool) -> dr.ArrayBase:
        place = self._layout.find(isinstance(vertex, int) and vertex == 0, component)
        if place is None:
            return (self._fresh.decide if decided else self._fresh.next_1d)(vertex, component)
        return self.values(vertex, place.slot)[place.index]

    def next_1d(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        """See :class:`SampleSource`."""
        return self._one(vertex, component, False)

    def next_2d(self, vertex: dr.ArrayBase | int, component: int) -> tuple[dr.ArrayBase, dr.ArrayBase]:
        """See :class:`SampleSource`."""
        place = self._layout.find(isinstance(vertex, int) and vertex == 0, component)
        if place is None:
            return self._fresh.next_2d(vertex, component)
        if place.slot.numbers == 2 and place.index == 0:
            first, second = self.values(vertex, place.slot)
            return first, second
        return self._one(vertex, component, False), self._one(vertex, component + 1, False)

    def decide(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        """See :class:`SampleSource`."""
        return self._one(vertex, component, True)
