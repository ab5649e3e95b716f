r"""Few bundles of many lines, or many of few: the split of the lines that an error of form factors needs.

With N lines a patch in all, L of them in a bundle, the variance of what a patch receives has two parts. That of the N/L
directions on a spiral falls with the square of their number, that of the places of lines as in :class:`ABuffer`:

.. math:: V(L) = a\,(L/N)^2 + b / (N \sqrt L), \qquad L = (b N / 4 a)^{2/5} \text{ where } V'(L) = 0.

b / 4a is 0.07 in cities of 5,000 and 22,000 facets and larger in coarse ones, where V hardly depends on L. Time is no
part of the choice, since a measured one would make lines depend on the machine: bundles of more lines take less of it
for each line, so that it, too, is in favour of a larger L.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.surfaces import Patches

from .abuffer import wanted_lines
from .generators import Bundles
from .periodic import PeriodicBundles

#: b / 4a, and the fewest directions, as many as runs to an error have at least: more would be those of other spirals.
_RATIO, _LEAST = 0.07, 128


@dataclass(frozen=True)
class Split:
    """``bundles`` of ``lines`` through the bounding sphere, ``each`` of them a patch in the mean."""

    lines: float
    bundles: int
    each: float

    def __str__(self) -> str:
        return (
            f"{self.bundles * self.each:.2g} lines a patch in {self.bundles} bundles of {self.each:.3g}, where the "
            "variance of directions and that of places are least together"
        )


def split_for(patches: Patches, error: float) -> Split | None:
    """The split of the lines for a standard error of the rows, averaged over patches; ``None`` where lines would be too
    many, and local rays are cast instead."""
    usual, most = wanted_lines(patches)
    if usual > most:
        return None
    generator = (Bundles if patches.period is None else PeriodicBundles)(patches, usual)
    hits = generator.expected(patches.areas, 1)[~patches.empty]
    mean = float(hits.mean())
    # The bundles for this error, if all have the usual lines.
    needed = float(np.mean(1 / np.sqrt(hits)) / error) ** 2
    factor = min((_RATIO * needed * mean) ** 0.4 / mean, most / usual, needed / _LEAST)
    factor = max(factor, 1.0)
    return Split(usual * factor, max(int(np.ceil(needed / factor)), _LEAST), mean * factor)
