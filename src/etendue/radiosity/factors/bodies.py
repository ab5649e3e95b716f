"""Exact form factors of surfaces of revolution: of the rings that their profile makes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, in_order, logger, sparse, threads
from etendue.surfaces import Patches

from ..compiling import compiled
from ..errors import RadiosityError
from ..lines.engine import warn_of_backs
from .formfactors import FormFactors, numbers_of
from .sections import pieces

#: The cylinder around everything, whose inside is the sky: larger by this, in sizes of the profile, and so many rings
#: in a size, since what is seen of the sky through an opening is a narrow band.
_AROUND, _PIECES = 0.05, 8
#: Errors of squares of two profiles are this share of the tolerance, over the root of the number of rings.
_SHARE = 0.25
#: Exchanges that are rounding, in squares of the size.
_NONE = 1e-13
#: Bytes for each pair of patches; rings whose time is measured.
_BYTES, _PILOT = 64, 6
#: A row sum is told if it is off by more, in its errors and the tolerance.
_OFF = 5.0


@dataclass(frozen=True)
class Body:
    """The rings of patches and the sky around them, in sizes of their profile.

    rings: (k, 4), which meet in their ends only. sides: (k, 2) the patches to the left and to the right, n for backs,
    n + 1 for the sky, -1 for nothing.
    """

    patches: Patches
    rings: Array
    sides: NDArray[np.int64]
    size: float

    @classmethod
    def of(cls, patches: Patches) -> Body | None:
        """``None`` unless the patches are surfaces of revolution."""
        if patches.rings is None:
            return None
        profile, n = patches.rings.profile, len(patches)
        face = np.unique(patches.rings.of, return_index=True)[1]
        sides = np.stack([patches.front[face], patches.back[face]], axis=1)
        low, high, most = profile[:, 1::2].min(), profile[:, 1::2].max(), profile[:, ::2].max()
        size = float(max(most, high - low))
        low, high, most = low - _AROUND * size, high + _AROUND * size, most + _AROUND * size
        corners = np.array([(0, low), (most, low), (most, high), (0, high)])
        ends = [np.linspace(a, b, int(np.ceil(np.abs(b - a).max() / size * _PIECES)) + 1) for a, b in pairwise(corners)]
        around = np.concatenate([np.hstack([way[:-1], way[1:]]) for way in ends])
        # In pieces from crossing to crossing, beyond which what they see is another.
        points, edges, of = pieces(profile[:, :2] / size, profile[:, 2:] / size)
        parts = points[edges].reshape(-1, 4) * size
        flat = np.flatnonzero(profile[of, 1] == profile[of, 3])
        parts[flat, 1::2] = profile[of[flat], 1::2]
        rings = np.concatenate([parts, around])
        rings[:, 1::2] -= (low + high) / 2
        sides = np.where(sides < 0, n, sides)[of]
        sides = np.concatenate([sides, np.full((len(around), 2), (n + 1, -1))])
        return cls(patches, rings / size, sides, size)

    def form_factors(self, tolerance: float, tell: Callable[[str], object]) -> FormFactors:
        """By adaptive integrals over the profiles, with the shadows of rings in closed form."""
        patches, n = self.patches, len(self.patches)
        need, free = _BYTES * (n + 2) ** 2, free_memory()
        if free is not None and need > free:
            raise RadiosityError(
                f"form factors of {n} rings need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: take fewer rings"
            )
        exchange, errors = np.zeros((n + 2, n + 2)), np.zeros((n + 2, n + 2))
        count = int((self.sides[:, 1] >= 0).sum())  # what the sky exchanges with itself is not wanted
        for i, found in enumerate(in_order(partial(self._row, k, tolerance) for k in range(count))):
            tell(f"integrating, {100 * i // count} %")
            for kind in range(4):
                a, b = self.sides[i, kind // 2], self.sides[i:, kind % 2]
                for matrix, values in zip((exchange, errors), found, strict=True):
                    np.add.at(matrix, (np.full(len(b), a), b), values[i:, kind])
        both, off = (self.size**2 * (x + x.T) for x in (exchange, errors))
        both = np.where(both < _NONE * self.size**2, 0.0, both)
        shares, spread = both[:n] / patches.divisors[:, None], off[:n] / patches.divisors[:, None]
        matrix = sparse().csr_array(shares[:, :n])
        row, column = matrix.tocoo().coords
        estimates = matrix.copy()
        estimates.data = spread[row, column]
        dark, sky = shares[:, n], shares[:, n + 1]
        warn_of_backs(float(dark @ patches.areas / patches.areas.sum()), "of what patches see is")
        _check_rows(patches, shares.sum(axis=1) - 1, _OFF * np.maximum(spread.sum(axis=1), tolerance))
        nothing = np.zeros(n, np.int64)
        return FormFactors(matrix, estimates, sky, patches.areas, nothing, dark, **numbers_of(patches))

    def seconds(self, tolerance: float) -> float:
        """The time that :meth:`form_factors` is going to take, from that of some rings."""
        count = int((self.sides[:, 1] >= 0).sum())
        self._row(count - 1, 0.5)  # loads or compiles
        some = np.unique(np.linspace(0, count - 1, 2 * _PILOT + 1).astype(int)[1::2])
        began = time.perf_counter()
        for i in some:
            self._row(int(i), tolerance)
        spent, total = time.perf_counter() - began, len(self.rings)
        return float(spent * count * (2 * total - count + 1) / 2 / (total - some).sum() / threads())

    def _row(self, i: int, tolerance: float) -> tuple[Array, Array]:
        rings = self.rings
        areas = np.pi * (rings[:, 0] + rings[:, 2]) * np.hypot(rings[:, 2] - rings[:, 0], rings[:, 3] - rings[:, 1])
        allowed = _SHARE * tolerance / np.sqrt(len(rings)) * np.minimum(areas[i], areas)
        exchange, errors = np.zeros((len(rings), 4)), np.zeros((len(rings), 4))
        seen = len(self.patches)
        compiled("factors.shadowcircles").exchange_of_ring(rings, self.sides, seen, i, allowed, exchange, errors)
        return exchange, errors


def _check_rows(patches: Patches, off: Array, allowed: Array) -> None:
    """Warn of rows that, with the sky and backs, do not sum to 1: a slit was missed."""
    if len(bad := np.flatnonzero(np.abs(off) > allowed)):
        worst = bad[np.abs(off[bad]).argmax()]
        logger.warning(
            "%d rows do not sum to 1, that of patch %d %s is off by %.2g: give a smaller tolerance (error)",
            *(len(bad), worst, f"('{patches.names[worst]}')" if patches.names[worst] else "", off[worst]),
        )
