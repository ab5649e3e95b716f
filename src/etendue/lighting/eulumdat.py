"""The photometric file format EULUMDAT (``.ldt``) [Stockmar 1990].

The package ``eulumdat-py`` 1.0 is not used: it returns rows without values for a file that is cut off, zeros for an
unknown symmetry or a number of planes that does not fit it, and mistakes one field for the next where a number is left
out.
"""

from __future__ import annotations

import re

import numpy as np

from etendue.core import Array, logger

from .errors import LightingError
from .web import PhotometricWeb, check_angles, whole_circle

#: Lines before and of each set of lamps, and the direct ratios after them.
_HEAD, _SET, _RATIOS = 26, 6, 10
#: Characters of a wrong line that a message shows.
_SHOWN = 24
#: Difference from the light output ratio of the file that is worth a warning.
_LOSS = 0.05


def parse_eulumdat(text: str, lamp_set: int | None = None) -> PhotometricWeb:
    """The web of a file. Plane C0 is +x, across the length of the luminaire.

    Intensities are those of the file, in cd per 1000 lm, times the lumens of a set of lamps and its conversion factor.
    ``lamp_set`` is the number of the set, from 1, or 0 for all together; by default it is the first, with a warning
    if there are others. A negative number of lamps means absolute photometry: the lumens are those of the luminaire.
    Raises :class:`LightingError` for what is missing or does not fit together.
    """
    lines = _Lines(text)
    symmetry, planes, angles = (lines.count(number, what, least) for number, what, least in _COUNTS)
    factor = lines.number(24, "conversion factor") or 1.0  # 0: not used
    sets = lines.count(26, "number of sets of lamps", 1)
    first = _HEAD + 1
    lamps = [lines.number(first + _SET * k, "number of lamps") for k in range(sets)]
    fluxes = [lines.number(first + _SET * k + 2, "flux of the lamps") for k in range(sets)]
    watts = [lines.number(first + _SET * k + 5, "power of the lamps") for k in range(sets)]
    chosen = _chosen(lamp_set, fluxes)
    lumens, power = sum(fluxes[chosen]), sum(watts[chosen])
    if not (lumens > 0.0 and factor > 0.0):
        raise LightingError(f"the lamps have {lumens:g} lm, times {factor:g}; give the flux of the lamps")
    values = lines.rest(first + _SET * sets + _RATIOS)
    c, gamma, values = _cut(values, planes, "C angles"), _cut(values[planes:], angles, "gamma angles"), values[planes:]
    check_angles("C angles", c)
    check_angles("gamma angles", gamma)
    c, stored = _stored(symmetry, c)
    candela = _cut(values[angles:], stored * angles, "intensities").reshape(stored, angles)
    if (more := len(values) - angles * (1 + stored)) > 0:
        raise LightingError(
            f"there are {more} more numbers than the intensities of {stored} planes of symmetry {symmetry}; correct "
            "the symmetry (line 3) or the number of planes (line 4)"
        )
    if symmetry == 0 and c[-1] < 360.0:
        c, candela = np.append(c, 360.0), np.concatenate([candela, candela[:1]])
    c, candela = whole_circle(c, candela * (factor * lumens / 1000.0))
    length, width, height = (lines.number(number, "luminous area") / 1000.0 for number in (16, 17, 18))
    is_absolute = min(lamps[chosen]) < 0.0
    web = PhotometricWeb(
        c,
        gamma,
        candela,
        lamp_flux=None if is_absolute else lumens,
        power=power if power > 0.0 else None,
        opening=(width or length, length, height),
        is_round=width == 0.0 and length > 0.0,
        name=lines.text(9),
    )
    ratio = lines.number(23, "light output ratio") / 100.0
    if ratio > 0.0 and not is_absolute and abs(web.flux / lumens - ratio) > _LOSS:
        logger.warning(
            f"the intensities give {web.flux:.4g} lm, but {ratio:.0%} of {lumens:g} lm are {ratio * lumens:.4g} lm; "
            "the former are used"
        )
    return web


#: Counts of the head: (line, meaning, least value).
_COUNTS = ((3, "symmetry", 0), (4, "number of C planes", 1), (6, "number of gamma angles", 2))


def _chosen(lamp_set: int | None, fluxes: list[float]) -> slice:
    """Which sets of lamps, of their ``fluxes`` in lm, are in the luminaire."""
    if lamp_set is None and len(fluxes) > 1:
        several = ", ".join(f"{k} of {flux:g} lm" for k, flux in enumerate(fluxes, 1))
        logger.warning(
            f"the file has {len(fluxes)} sets of lamps ({several}), of which the first is used; choose another by "
            "lamp_set, or 0 for all together"
        )
    if lamp_set == 0:
        return slice(None)
    number = 1 if lamp_set is None else lamp_set
    if number > len(fluxes):
        raise LightingError(f"there is no set of lamps {number} among {len(fluxes)}; choose one of them, or 0 for all")
    return slice(number - 1, number)


def _stored(symmetry: int, c: Array) -> tuple[Array, int]:
    """(angles of the planes whose intensities are in the file, their number), of the angles (planes,) of all planes."""
    planes, quarter = len(c), len(c) // 4
    if symmetry > 4:
        raise LightingError(f"the symmetry (line 3) is {symmetry}; it is one of 0, 1, 2, 3, 4")
    if symmetry == 1:
        return c[:1], 1
    if symmetry == 0:
        if c[0] != 0.0 or c[-1] > 360.0:
            raise LightingError(f"C angles go from {c[0]:g} to {c[-1]:g} degrees; they go from 0 to below 360")
        return c, planes
    if symmetry == 2:
        part, ends, stored = c[: planes // 2 + 1], (0.0, 180.0), planes // 2 + 1
    elif symmetry == 3:
        part, ends, stored = np.append(c[3 * quarter :] - 360.0, c[: quarter + 1]), (-90.0, 90.0), planes // 2 + 1
    else:
        part, ends, stored = c[: quarter + 1], (0.0, 90.0), quarter + 1
    if len(part) != stored or not np.allclose((part[0], part[-1]), ends):
        raise LightingError(
            f"the {planes} C planes (line 4) have none at {ends[0] % 360:g} or {ends[1]:g} degrees where symmetry "
            f"{symmetry} (line 3) expects it; correct either"
        )
    return part, stored


def _cut(values: Array, count: int, what: str) -> Array:
    if len(values) < count:
        raise LightingError(f"{what}: there are {len(values)} of {count} numbers; the file is not complete")
    return values[:count]


class _Lines:
    """The lines of a file by their number in the description of the format, from 1. An empty number is 0."""

    def __init__(self, text: str) -> None:
        self._lines = [line.strip() for line in text.replace("\x1a", "").splitlines()]
        if len(self._lines) < _HEAD:
            raise LightingError(f"there are {len(self._lines)} lines, too few; this is no IES or EULUMDAT file")

    def text(self, number: int) -> str:
        """A line, "" beyond the last."""
        return self._lines[number - 1] if number <= len(self._lines) else ""

    def number(self, number: int, what: str) -> float:
        """The number in a line."""
        word = self.text(number)
        try:
            value = float(word.replace(",", ".") or 0.0)
        except ValueError:
            raise LightingError(
                f"{what} (line {number}) is {word[:_SHOWN]!r}, no number; is this an IES or EULUMDAT file?"
            ) from None
        if not np.isfinite(value):
            raise LightingError(f"{what} (line {number}) is {value:g}; it is a finite number")
        return value

    def count(self, number: int, what: str, least: int) -> int:
        """The number in a line, a whole number."""
        value = self.number(number, what)
        if not (least <= value < 1e6 and value == int(value)):
            raise LightingError(f"{what} (line {number}) is {value:g}; it is a whole number of at least {least}")
        return int(value)

    def rest(self, first: int) -> Array:
        """The numbers from a line to the end, or to the first line of text."""
        values: list[float] = []
        for line in self._lines[first - 1 :]:
            try:
                values += [float(word.replace(",", ".")) for word in re.split(r"[\s;]+", line) if word]
            except ValueError:
                break
        return np.array(values)
