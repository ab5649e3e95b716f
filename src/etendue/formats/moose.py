"""View factors between sidesets as a block of MOOSE's heat transfer module."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from .errors import FormatError

if TYPE_CHECKING:
    import scipy.sparse


def check_moose_names(names: Sequence[str]) -> None:
    """Raise :class:`FormatError` for a name that a list of MOOSE cannot contain."""
    for name in names:
        if not name or set(name) & set(" \t\n'\";[]"):
            raise FormatError(
                f"MOOSE has no names with blanks, quotes, ';' or brackets in lists, as '{name}': rename it"
            )


def moose_lines(matrix: scipy.sparse.csr_array, names: Sequence[str]) -> Iterator[str]:
    """Lines of an input file with a ``SpecifiedViewFactor``: the sidesets, and the rows of F (n, n) in their order,
    separated by semicolons. Raises :class:`FormatError` for names that it cannot contain."""
    check_moose_names(names)
    yield "[UserObjects]\n  [view_factors]\n    type = SpecifiedViewFactor\n"
    yield f"    boundary = '{' '.join(names)}'\n    view_factors = '"
    for i in range(len(names)):
        row = " ".join(f"{factor:.9g}" for factor in matrix[[i]].toarray()[0])
        yield row + (";\n                    " if i + 1 < len(names) else "'\n")
    yield "  []\n[]\n"
