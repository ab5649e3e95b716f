"""The photometric file format IES LM-63, of 1986, 1991, 1995, 2002 [IES 2002] and 2019."""

from __future__ import annotations

import re

import numpy as np

from etendue.core import Array

from .errors import LightingError
from .tilt import Tilt
from .web import PhotometricWeb, check_angles, whole_circle

_TILT = re.compile(r"^\s*TILT\s*=\s*(.*?)\s*$", re.IGNORECASE)
_KEYWORD = re.compile(r"^\s*\[(\w+)\]\s*(.*?)\s*$")
_METRES = {1: 0.3048, 2: 1.0}
#: Characters of a wrong word that a message shows.
_SHOWN = 24
_TYPES = {1: "C", 2: "B", 3: "A"}


def is_ies(text: str) -> bool:
    """Whether the text of a photometric file is in this format."""
    return text.lstrip().upper().startswith("IES") or any(map(_TILT.match, text.splitlines()))


def parse_ies(text: str) -> PhotometricWeb:
    """The web of a file of type C. The horizontal angle 0 is C = 0 (+x), along the length of the opening.

    Intensities are those of the file times its multiplier and its ballast factor, and, in files of 1986 and 1991, the
    ballast-lamp photometric factor; later files have other things in this place. Factors for the tilt of a lamp are
    kept apart. Raises :class:`LightingError` for what is missing or does not fit together, for types A and B, and for
    tilt factors in another file.
    """
    lines = text.splitlines()
    start, tilt = _start(lines)
    numbers = _Numbers(" ".join(lines[start:]))
    factors = _tilt(tilt, numbers)
    lamps, lumens, multiplier = numbers.take(3, "lamp data")
    angles, planes = numbers.count("vertical angles"), numbers.count("horizontal angles")
    kind, units, width, length, height = numbers.take(5, "photometric type, units and opening")
    ballast, third, power = numbers.take(3, "ballast factor and input watts")
    if kind not in _TYPES:
        raise LightingError(f"the photometric type is {kind:g}; it is 1 (C), 2 (B) or 3 (A)")
    if kind != 1:
        raise LightingError(
            f"the photometry is of type {_TYPES[int(kind)]}, which is not supported; convert it to type C"
        )
    if units not in _METRES:
        raise LightingError(f"the type of units is {units:g}; it is 1 (feet) or 2 (metres)")
    if lumens == 0.0 or lamps < 1.0 or (lumens < 0.0 and lumens != -1.0):
        raise LightingError(
            f"{lamps:g} lamps have {lumens:g} lumens each; give at least one lamp and its lumens, or -1 lumens for "
            "absolute photometry"
        )
    factor = multiplier * ballast * (third if _has_photometric_factor(lines) else 1.0)
    if not factor > 0.0:
        raise LightingError(f"intensities are multiplied by {factor:g}; correct the multiplier or the ballast factor")
    gamma = numbers.take(angles, "vertical angles")
    c = numbers.take(planes, "horizontal angles")
    candela = numbers.take(planes * angles, "intensities").reshape(planes, angles)
    if numbers.left:
        raise LightingError(
            f"there are {numbers.left} more numbers than those of {planes} horizontal and {angles} vertical angles; "
            "correct the counts"
        )
    check_angles("vertical angles", gamma)
    c, candela = whole_circle(c, candela * factor)
    metre = _METRES[int(units)]
    return PhotometricWeb(
        c,
        gamma,
        candela,
        lamp_flux=None if lumens < 0.0 else float(lamps * lumens),
        power=float(power) if power > 0.0 else None,
        opening=(abs(length) * metre, abs(width) * metre, abs(height) * metre),
        is_round=bool(width < 0.0),
        name=_name(lines[:start]),
        tilt=factors,
    )


def _start(lines: list[str]) -> tuple[int, str]:
    """The line after ``TILT=`` and its value. Without it, the first of the lines of numbers that end the file."""
    for number, line in enumerate(lines):
        if found := _TILT.match(line):
            return number + 1, found[1]
    start = len(lines)
    while start and not re.search(r"[^\d\s,;.eE+-]", lines[start - 1]):
        start -= 1
    return start, ""


def _tilt(value: str, numbers: _Numbers) -> Tilt | None:
    """The factors that follow a line ``TILT=``; None if there are none, or if all are 1."""
    if value.upper() in ("NONE", ""):
        return None
    if value.upper() != "INCLUDE":
        raise LightingError(
            f"TILT={value}: tilt factors in a file of their own are not read; write TILT=INCLUDE, and below it the "
            "lines of that file"
        )
    (geometry,) = numbers.take(1, "lamp-to-luminaire geometry")
    pairs = numbers.count("pairs of tilt angles and factors")
    angles = numbers.take(pairs, "tilt angles")
    found = Tilt(geometry, angles, numbers.take(pairs, "tilt factors"))
    return None if (found.factors == 1.0).all() else found


def _has_photometric_factor(lines: list[str]) -> bool:
    """Whether the number after the ballast factor is a factor, too: in files of 1991, and of 1986, which do not name
    the format."""
    first = next((line.strip().upper() for line in lines if line.strip()), "")
    return not first.startswith("IES") or bool(re.match(r"IESNA\W*(LM-63-)?(19)?(86|91)\b", first))


def _name(lines: list[str]) -> str:
    found = {m[1].upper(): m[2] for line in lines if (m := _KEYWORD.match(line)) and m[2]}
    return next((found[key] for key in ("LUMINAIRE", "LUMCAT", "OTHER", "MANUFAC") if key in found), "")


class _Numbers:
    """The numbers of a file in order, however they are spread over lines."""

    def __init__(self, text: str) -> None:
        self._words = [word for word in re.split(r"[\s,;\x1a]+", text) if word]
        self._next = 0

    @property
    def left(self) -> int:
        """How many are not taken."""
        return len(self._words) - self._next

    def take(self, count: int, what: str) -> Array:
        """(count,) the next numbers."""
        words = self._words[self._next : self._next + count]
        if len(words) < count:
            raise LightingError(f"{what}: there are {len(words)} of {count} numbers; the file is not complete")
        self._next += count
        try:
            return np.array([float(word) for word in words])
        except ValueError:
            word = next(word for word in words if not _is_number(word))
            raise LightingError(f"{what}: {word[:_SHOWN]!r} is not a number; correct the file") from None

    def count(self, what: str) -> int:
        """The next number, a count."""
        (value,) = self.take(1, f"number of {what}")
        if not (1.0 <= value < 1e6 and value == int(value)):
            raise LightingError(f"the number of {what} is {value:g}; it is a whole number of at least 1")
        return int(value)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
