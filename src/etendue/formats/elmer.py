"""View factors as Elmer reads them from ``ViewFactors.dat``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import scipy.sparse


def elmer_lines(matrix: scipy.sparse.csr_array) -> Iterator[str]:
    """Lines of the text, from the CSR ``matrix`` (n, n): for each radiating boundary element, in the order of the mesh,
    the number of its entries, then i, j, counted from 1, and F from i to j."""
    for i in range(matrix.shape[0]):
        begin, end = matrix.indptr[i], matrix.indptr[i + 1]
        yield f"{end - begin}\n"
        for k in range(begin, end):
            yield f"{i + 1} {matrix.indices[k] + 1} {matrix.data[k]:.9g}\n"
