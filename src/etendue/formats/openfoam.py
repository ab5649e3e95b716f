"""View factors as OpenFOAM's radiation model ``viewFactor`` reads them: lists by face, of F and of the faces seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import scipy.sparse


def openfoam_factor_lines(matrix: scipy.sparse.csr_array) -> Iterator[str]:
    """Lines of ``constant/F``: for each face the factors F (n, n) to those that it sees."""
    yield from _lines(matrix.indptr, matrix.data, "scalarListList", "F", lambda factor: f"{factor:.9g}")


def openfoam_face_lines(matrix: scipy.sparse.csr_array) -> Iterator[str]:
    """Lines of ``constant/globalFaceFaces``: the indices of these faces, counted from 0, in the same shape."""
    yield from _lines(matrix.indptr, matrix.indices, "labelListList", "globalFaceFaces", str)


def _lines(starts: Any, values: Any, kind: str, name: str, text: Callable[[Any], str]) -> Iterator[str]:
    yield "FoamFile\n{\n    version     2.0;\n    format      ascii;\n"
    yield f'    class       {kind};\n    location    "constant";\n    object      {name};\n}}\n\n'
    yield f"{len(starts) - 1}\n(\n"
    for begin, end in pairwise(starts):
        yield f"{end - begin}({' '.join(map(text, values[begin:end]))})\n"
    yield ")\n"
