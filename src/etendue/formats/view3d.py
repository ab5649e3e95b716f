"""Form factors as the text that View3D 3.2 writes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from etendue.core import Array

if TYPE_CHECKING:
    import scipy.sparse


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


def _line(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values) + "\n"
