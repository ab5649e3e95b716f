"""Photometric files of either format."""

from __future__ import annotations

import os
from pathlib import Path

from .errors import LightingError
from .eulumdat import parse_eulumdat
from .ies import is_ies, parse_ies
from .web import PhotometricWeb


def read_photometry(path: str | os.PathLike[str]) -> PhotometricWeb:
    """The photometric web of a file, IES LM-63 or EULUMDAT, by its content.

    Raises :class:`LightingError` with one line that names the file: if it cannot be read, is cut off, or describes no
    luminaire that gives light.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise LightingError(f"{path} cannot be read: {error.strerror}") from error
    text = _decoded(data)
    try:
        return parse_ies(text) if is_ies(text) else parse_eulumdat(text)
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
