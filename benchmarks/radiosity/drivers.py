"""What draws lines in the thesis: independent numbers, sequences, and two ways to do it wrong.

Every set is moved by a random vector modulo 1, another one for each seed, or is random itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

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
    "consecutive halton": lambda count, seed: RandomShift(ConsecutiveHalton(4), seed),
}
