"""Form factors of the zones of a building, each computed by itself, as one matrix."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import sparse
from etendue.surfaces import Patches

from .formfactors import FormFactors, numbers_of


def joined_zones(patches: Patches, zones: Sequence[tuple[FormFactors, NDArray[np.int64]]]) -> FormFactors:
    """Form factors of ``patches`` from those of its zones, and the patches (k,) that the rows of each zone are: zero
    between zones. Rows of patches in no zone, such as empty ones, are zero."""
    n, ours = len(patches), np.concatenate([rows for _, rows in zones])

    def placed(name: str) -> Any:
        """The matrices of all zones in one."""
        parts = [getattr(factors, name).tocoo() for factors, _ in zones]
        row, column = (
            np.concatenate([rows[getattr(part, end)] for part, (_, rows) in zip(parts, zones, strict=True)])
            for end in ("row", "col")
        )
        return sparse().coo_array((np.concatenate([part.data for part in parts]), (row, column)), shape=(n, n)).tocsr()

    def spread(name: str) -> NDArray[Any] | None:
        values = [getattr(factors, name) for factors, _ in zones]
        if any(value is None for value in values):
            return None
        whole = np.concatenate(values)
        made = np.zeros((n, *whole.shape[1:]), whole.dtype)
        made[ours] = whole
        return made

    ends: dict[str, Any] = {name: spread(name) for name in ("sky", "lines", "dark", "ground", "sky_patches")}
    return FormFactors(placed("matrix"), placed("errors"), areas=patches.areas, **ends, **numbers_of(patches))
