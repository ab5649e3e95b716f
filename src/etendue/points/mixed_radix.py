"""Codes of strata: one number for the segments of all dimensions of a box."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class MixedRadix:
    """Numbers with ``counts[i]`` as the base of digit i, the lowest first [Leeson 2001, eqs. 5.23 and 5.24]:

    ``code = sum_i digit_i prod_{j<i} counts_j``, and ``digit_i = floor(code / prod_{j<i} counts_j) mod counts_i``.

    A range of codes, two integers, names a part of a divided box. Raises ``ValueError`` for counts below 1.
    """

    counts: tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.counts or min(self.counts) < 1:
            raise ValueError(f"a dimension has at least one segment, not {self.counts}")

    def __len__(self) -> int:
        return math.prod(self.counts)

    def digits(self, codes: Any) -> list[Any]:
        """The segment in each dimension; of numbers, or of arrays of NumPy or Dr.Jit."""
        found = []
        for count in self.counts:
            found.append(codes % count)
            codes = codes // count
        return found

    def code(self, digits: Sequence[Any]) -> Any:
        """Inverse of :meth:`digits`."""
        code, unit = 0 * digits[0], 1
        for digit, count in zip(digits, self.counts, strict=True):
            code = code + digit * unit
            unit *= count
        return code

    def box(self, code: int) -> NDArray[np.float64]:
        """(2, d): the corners of a stratum of the unit cube."""
        digits, counts = np.array(self.digits(int(code))), np.array(self.counts)
        return np.stack([digits / counts, (digits + 1) / counts])
