"""View factors of a zone as the object ``ZoneProperty:UserViewFactors:BySurfaceName`` of EnergyPlus."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from .errors import FormatError

if TYPE_CHECKING:
    import scipy.sparse

_OBJECT = "ZoneProperty:UserViewFactors:BySurfaceName"
#: The field of the name in recent versions; earlier ones have ``zone_or_zonelist_name``.
_ZONE = "zone_or_zonelist_or_space_or_spacelist_name"


def check_idf_names(names: Sequence[str]) -> None:
    """Raise :class:`FormatError` for a name that a text of EnergyPlus cannot contain."""
    for name in names:
        if re.search(r"[,;!\n]", name):
            raise FormatError(f"EnergyPlus has no names with ',', ';' or '!', as '{name}': rename it")


def energyplus_lines(matrix: scipy.sparse.csr_array, names: Sequence[str], zone: str) -> Iterator[str]:
    """Lines of an IDF file: the ``zone``, then for every pair of surfaces, also of one with itself, the names of both
    and F (n, n) from the first to the second. Raises :class:`FormatError` for names that it cannot contain."""
    check_idf_names([zone, *names])
    yield f"{_OBJECT},\n  {zone},\n"
    last = len(names) ** 2 - 1
    for k, (first, second, factor) in enumerate(_pairs(matrix, names)):
        yield f"  {first}, {second}, {factor:.8f}{';' if k == last else ','}\n"


def energyplus_json(matrix: scipy.sparse.csr_array, names: Sequence[str], zone: str) -> Iterator[str]:
    """The same as epJSON, in the schema of recent versions."""
    factors = [
        {"from_surface": first, "to_surface": second, "view_factor": round(factor, 8)}
        for first, second, factor in _pairs(matrix, names)
    ]
    content = {_OBJECT: {f"view factors {zone}": {_ZONE: zone, "view_factors": factors}}}
    yield json.dumps(content, indent=1) + "\n"


def _pairs(matrix: scipy.sparse.csr_array, names: Sequence[str]) -> Iterator[tuple[str, str, float]]:
    for i, first in enumerate(names):
        row = matrix[[i]].toarray()[0]
        for second, factor in zip(names, row.tolist(), strict=True):
            yield first, second, factor
