"""Form factors as the text that View3D 3.2 writes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from etendue.core import Array

from .errors import FormatError

if TYPE_CHECKING:
    import scipy.sparse


class View3dFactors(NamedTuple):
    """The content of a file: F (n, n), areas (n,), emissivities (n,), and whether it is said to be of an enclosure."""

    matrix: Array
    areas: Array
    emissivity: Array
    is_closed: bool


def view3d_lines(matrix: scipy.sparse.csr_array, areas: Array, emissivity: Array, is_closed: bool) -> Iterator[str]:
    """Lines of the text: "program version format enclosure emissivities-used patches", as View3D's reader expects it;
    areas (n,), the rows of the CSR ``matrix`` (n, n) with their zeros, and emissivities (n,)."""
    count = len(areas)
    yield f"View3D 3.2 0 {int(is_closed)} 0 {count}\n"
    yield _line(areas)
    for i in range(count):
        row = ["0"] * count
        for k in range(matrix.indptr[i], matrix.indptr[i + 1]):
            row[matrix.indices[k]] = f"{matrix.data[k]:.7g}"
        yield " ".join(row) + "\n"
    yield _line(emissivity)


def read_view3d(path: str | os.PathLike[str]) -> View3dFactors:
    """Read a file of View3D: text, or binary (32 bytes of heading, then numbers of single precision).

    Raises :class:`FormatError` for another file, and for factors that contain reflections (``emit=1``).
    """
    try:
        content = Path(path).read_bytes()
    except OSError:
        raise FormatError(f"there is no file of form factors '{path}'") from None
    words = content.split(b"\n", 1)[0][:32].split()
    try:
        layout, closed, reflections, count = map(int, words[2:6])
        if words[0].lower() != b"view3d" or layout not in (0, 1):
            raise ValueError
        if layout == 0:
            values = np.array(content.split(b"\n", 1)[1].split(), dtype=np.float64)
        else:
            values = np.frombuffer(content, "<f4", offset=32).astype(np.float64)
        areas, matrix, emissivity = np.split(values, [count, count + count**2])
        matrix = matrix.reshape(count, count)
        if len(emissivity) != count or not np.isfinite(values).all():
            raise ValueError
    except (ValueError, IndexError):
        raise FormatError(f"'{path}' is no file of form factors of View3D, as text or binary (out=0 or 1)") from None
    if reflections:
        raise FormatError(f"'{path}' contains reflections between its surfaces: let View3D write it with emit=0")
    return View3dFactors(matrix, areas, emissivity, bool(closed))


def _line(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values) + "\n"
