"""Photometric files of either format."""

from __future__ import annotations

import os
from pathlib import Path

from .errors import LightingError
from .eulumdat import parse_eulumdat
from .ies import is_ies, parse_ies
from .web import PhotometricWeb


def read_photometry(path: str | os.PathLike[str], lamp_set: int | None = None) -> PhotometricWeb:
    """The photometric web of a file, IES LM-63 or EULUMDAT, by its content.

    lamp_set: number from 1 of the set of lamps of an EULUMDAT file, 0 for all together. By default it is the first.

    Raises :class:`LightingError` with one line that names the file: if it cannot be read, is cut off, describes no
    luminaire that gives light, or has no such set of lamps.
    """
    if not (lamp_set is None or (isinstance(lamp_set, int) and not isinstance(lamp_set, bool) and lamp_set >= 0)):
        raise LightingError(f"a set of lamps is a number from 1, or 0 for all together, not {lamp_set!r}")
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise LightingError(f"{path} cannot be read: {error.strerror}") from error
    text = _decoded(data)
    try:
        if not is_ies(text):
            return parse_eulumdat(text, lamp_set)
        if lamp_set is not None:
            raise LightingError("it is an IES file, which has no sets of lamps; leave out lamp_set")
        return parse_ies(text)
    except LightingError as error:
        raise LightingError(f"{path}: {error}") from None


def _decoded(data: bytes) -> str:
    """The text of a file; neither format has an encoding."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
