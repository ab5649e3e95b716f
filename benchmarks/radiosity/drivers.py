"""What draws lines: the independent numbers and sequences of the thesis, and two that show why some of these fail.

Every set is moved by a random vector modulo 1, another one for each seed, or is random itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from etendue.points import (
    FaureHalton,
    Halton,
    Independent,
    OwenSobol,
    PointSet,
    RandomShift,
    Sobol,
    Weyl,
    radical_inverse,
)


class ThesisHammersley(PointSet):
    """Hammersley's points as the thesis has them: ``i / n``, and radical inverses in the bases 3, 5 and 7."""

    name = "hammersley-3-5-7"
    max_dimension = 4
    citations: ClassVar[tuple[str, ...]] = ("Hammersley1960", "Castro2002")

    def _coordinate(self, index: Any, dimension: int) -> Any:
        assert self.size is not None
        return index / float(self.size) if dimension == 0 else radical_inverse(index, (3, 5, 7)[dimension - 1])


class ConsecutiveHalton(PointSet):
    """Two points in a row of Halton's sequence in two dimensions as one in four: what a line must not be made of."""

    name = "consecutive-halton"
    max_dimension = 4
    citations: ClassVar[tuple[str, ...]] = ("Halton1960", "Castro2002")

    def _coordinate(self, index: Any, dimension: int) -> Any:
        return radical_inverse(2 * index + dimension // 2, 2 + dimension % 2)


class ShuffledHammersley(ThesisHammersley):
    """The same points in a random order, so that lines drawn one after the other have nothing in common."""

    name = "shuffled-hammersley"

    def __init__(self, dimension: int, size: int, seed: int) -> None:
        super().__init__(dimension, size)
        self._order = np.random.default_rng(seed).permutation(size).astype(np.uint32)

    def _coordinate(self, index: Any, dimension: int) -> Any:
        return super()._coordinate(self._order[index], dimension)


class GoldenWeyl(PointSet):
    """``frac(i / g^(d + 1))`` with g^5 = g + 1, the golden ratio's cousin in four dimensions: like Weyl's points, but
    sums of small multiples of the four numbers keep away from whole ones."""

    name = "golden-weyl"
    max_dimension = 4

    def _coordinate(self, index: Any, dimension: int) -> Any:
        return np.mod(index * _GOLDEN ** -(dimension + 1.0), 1.0)


#: The root above 1 of g^5 = g + 1.
_GOLDEN = float(max(np.roots([1, 0, 0, 0, -1, -1]).real))

#: (number of points, seed) to a set of four dimensions.
Driver = Callable[[int, int], PointSet]

INDEPENDENT = "independent"
DRIVERS: dict[str, Driver] = {
    INDEPENDENT: lambda count, seed: Independent(4, seed),
    "halton": lambda count, seed: RandomShift(Halton(4), seed),
    "scrambled halton": lambda count, seed: RandomShift(FaureHalton(4), seed),
    "sobol": lambda count, seed: RandomShift(Sobol(4), seed),
    "owen-sobol": lambda count, seed: OwenSobol(4, seed),
    "weyl": lambda count, seed: RandomShift(Weyl(4), seed),
    "hammersley": lambda count, seed: RandomShift(ThesisHammersley(4, count), seed),
    "shuffled hammersley": lambda count, seed: RandomShift(ShuffledHammersley(4, count, seed), seed),
    "golden weyl": lambda count, seed: RandomShift(GoldenWeyl(4), seed),
    "consecutive halton": lambda count, seed: RandomShift(ConsecutiveHalton(4), seed),
}
