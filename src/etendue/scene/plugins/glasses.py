"""Indices of refraction by wavelength, and those of some materials.

Two formulas, with the wavelength in micrometres:

    Sellmeier: n^2 = 1 + sum_i B_i w^2 / (w^2 - C_i)        Cauchy: n = A + B / w^2 + C / w^4
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.core import OptionError, suggest

#: Wavelengths of the Fraunhofer lines F, d and C, in micrometres, by which the Abbe number is defined.
_F, _D, _C = 0.4861327, 0.5875618, 0.6562725


@dataclass(frozen=True)
class Index:
    """An index of refraction; ``numbers``: B_1, C_1, B_2, C_2, ... of Sellmeier's formula, or A, B, C of Cauchy's."""

    numbers: tuple[float, ...]
    is_sellmeier: bool = False

    def at(self, wavelength: Any, numbers: Sequence[Any] = ()) -> Any:
        """At wavelengths in nanometres; ``numbers``: the same on the device."""
        square = (wavelength * 1e-3) ** 2
        numbers = numbers or self.numbers
        if not self.is_sellmeier:
            a, b, c = numbers
            return a + (b + c / square) / square
        terms = zip(numbers[::2], numbers[1::2], strict=True)
        return (1.0 + sum(b * square / (square - c) for b, c in terms)) ** 0.5


def constant(index: float) -> Index:
    """The same index at all wavelengths."""
    return Index((index, 0.0, 0.0))


def of_abbe(index: float, number: float) -> Index:
    """By the index at the line d and the Abbe number V = (n_d - 1) / (n_F - n_C), in Cauchy's formula without C."""
    slope = (index - 1.0) / (number * (_F**-2 - _C**-2))
    return Index((index - slope * _D**-2, slope, 0.0))


def abbe_number(index: Index) -> float:
    """The Abbe number V; infinite without dispersion."""
    at_f, at_d, at_c = (float(index.at(1e3 * line)) for line in (_F, _D, _C))
    return (at_d - 1.0) / (at_f - at_c) if at_f != at_c else float(np.inf)


_WATER = (
    *(0.5684027565, 0.005101829712, 0.1726177391, 0.01821153936),
    *(0.02086189578, 0.02620722293, 0.1130748688, 10.69792721),
)
#: Glasses by the catalogue of Schott (2023); fused silica [Malitson 1965], sapphire, of the ordinary ray [Malitson
#: 1972], diamond [Peter 1923], water at 20 degrees [Daimon 2007]. Air has no dispersion that could be seen.
GLASSES = {
    "vacuum": constant(1.0),
    "air": constant(1.000277),
    "bk7": Index((1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653), True),
    "k7": Index((1.1273555, 0.00720341707, 0.124412303, 0.0269835916, 0.827100531, 100.384588), True),
    "n-bak4": Index((1.28834642, 0.00779980626, 0.132817724, 0.0315631177, 0.945395373, 105.965875), True),
    "f2": Index((1.34533359, 0.00997743871, 0.209073176, 0.0470450767, 0.937357162, 111.886764), True),
    "sf10": Index((1.62153902, 0.0122241457, 0.256287842, 0.0595736775, 1.64447552, 147.468793), True),
    "n-sf11": Index((1.73759695, 0.013188707, 0.313747346, 0.0623068142, 1.89878101, 155.23629), True),
    "n-lasf9": Index((2.00029547, 0.0121426017, 0.298926886, 0.0538736236, 1.80691843, 156.530829), True),
    "fused silica": Index((0.6961663, 0.0684043**2, 0.4079426, 0.1162414**2, 0.8974794, 9.896161**2), True),
    "sapphire": Index((1.4313493, 0.0726631**2, 0.65054713, 0.1193242**2, 5.3414021, 18.028251**2), True),
    "diamond": Index((4.3356, 0.106**2, 0.3306, 0.175**2), True),
    "water": Index(_WATER, True),
}


def glass(name: str) -> Index:
    """A material by its name. Raises :class:`OptionError` for an unknown one."""
    if name not in GLASSES:
        raise OptionError(f"no index of refraction is known for '{name}'; {suggest(name, list(GLASSES))}")
    return GLASSES[name]
