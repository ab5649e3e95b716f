"""A matrix with names of its rows and columns as comma-separated values."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from etendue.core import Array

if TYPE_CHECKING:
    import scipy.sparse


def table_lines(
    matrix: scipy.sparse.csr_array, names: Sequence[str], more: Mapping[str, Array], corner: str = "name"
) -> Iterator[str]:
    """Lines of the table: names of the columns, then rows of the CSR ``matrix`` (n, n) with their zeros, each after its
    name and followed by its values of the columns ``more`` (n,)."""
    yield _row([corner, *names, *more])
    for i, name in enumerate(names):
        row = ["0"] * len(names)
        for k in range(matrix.indptr[i], matrix.indptr[i + 1]):
            row[matrix.indices[k]] = f"{matrix.data[k]:.9g}"
        yield _row([name, *row, *(f"{values[i]:.9g}" for values in more.values())])


def _row(cells: Sequence[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()
