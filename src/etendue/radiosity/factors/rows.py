"""Form factors of some of the patches, and their union: rows of the tiles of a city."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RadiosityError
from .formfactors import FormFactors

#: Relative difference of areas of the same patch.
_SAME_AREA = 1e-9


def known_rows(factors: FormFactors) -> NDArray[np.bool_]:
    """(n,) rows that lines, rays or integrals have found: all but those of empty patches, and those without rays and
    form factors beside others with rays. Rows of integrals have no rays, but form factors."""
    with_area = factors.areas > 0
    if not np.any(factors.lines > 0):
        return with_area
    return with_area & ((factors.lines > 0) | (factors.row_sums() + factors.dark > 0))


def joined_rows(parts: Sequence[FormFactors], names: Sequence[str]) -> FormFactors:
    """Form factors of all patches from those of some of them each, which have zeros in other rows.

    names: of the parts, for messages. Raises :class:`RadiosityError` for parts of other patches, for a row that is in
    two parts, and for one that is in none.
    """
    first = parts[0]
    found = np.full(len(first), -1)
    for k, (part, name) in enumerate(zip(parts, names, strict=True)):
        if len(part) != len(first) or (np.abs(part.areas - first.areas) > _SAME_AREA * first.areas).any():
            raise RadiosityError(
                f"'{name}' and '{names[0]}' are of other patches: name all files, in the same order, in each run"
            )
        known = known_rows(part)
        if (twice := known & (found >= 0)).any():
            row = int(np.argmax(twice))
            raise RadiosityError(f"row {row} is in both of '{names[found[row]]}' and '{name}': leave out one")
        if set(part.ends) != set(first.ends):
            raise RadiosityError(f"only one of '{names[0]}' and '{name}' has the ground apart: compute them alike")
        found[known] = k
    missing = np.flatnonzero((found < 0) & (first.areas > 0))
    if len(missing):
        whose = "" if first.name is None or not first.name[missing[0]] else f" (of '{first.name[missing[0]]}')"
        raise RadiosityError(
            f"{len(missing)} of {len(first)} rows are in no file, the first is row {missing[0]}{whose}: name the files "
            "of all tiles"
        )
    matrix, errors = parts[0].matrix, parts[0].errors
    for part in parts[1:]:
        matrix, errors = matrix + part.matrix, errors + part.errors
    lines = np.sum([part.lines for part in parts], axis=0)
    ends: dict[str, Any] = {name: np.sum([part.ends[name] for part in parts], axis=0) for name in first.ends}
    return replace(first, matrix=matrix.tocsr(), errors=errors.tocsr(), lines=lines, **ends)
