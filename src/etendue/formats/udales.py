"""View factors as uDALES reads them (``lvfsparse``): rows are the facets of the STL file in its order."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from etendue.core import Array, library
from etendue.film import replacing

if TYPE_CHECKING:
    import scipy.sparse


def udales_lines(matrix: scipy.sparse.csr_array) -> Iterator[str]:
    """Lines of ``vfsparse.inp.NNN``, in the order of the CSR ``matrix`` (n, n): i, j, counted from 1, and F from i to j
    with eight decimals; factors that would be written as zero are left out. Their number is ``nnz`` of the namoptions.
    """
    entries = matrix.tocoo()
    for i, j, factor in zip(entries.row + 1, entries.col + 1, entries.data, strict=True):
        if (text := f"{factor:.8f}") != "0.00000000":
            yield f"{i} {j} {text}\n"


def udales_sky_lines(sky: Array) -> Iterator[str]:
    """Lines of ``svf.inp.NNN``: a comment, and the sky view factor of each facet."""
    yield "# sky view factors\n"
    yield from (f"{share:.8f}\n" for share in sky)


def write_udales_netcdf(path: str | os.PathLike[str], matrix: scipy.sparse.csr_array) -> None:
    """Write ``vf.nc.inp.NNN``: netCDF of the classic format with the variable ``view factor`` (columns, rows) in single
    precision: the transpose of ``matrix`` (n, n), as in the files of uDALES."""
    netcdf = library("scipy.io", f"the netCDF file {path}")
    dense = np.ascontiguousarray(matrix.T.toarray(), dtype=">f4")
    with replacing(path) as part, netcdf.netcdf_file(str(part), "w", mmap=False, version=2) as file:
        file.createDimension("rows", len(dense))
        file.createDimension("columns", len(dense))
        file.createVariable("view factor", "f4", ("columns", "rows"))[:] = dense
