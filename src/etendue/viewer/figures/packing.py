"""Arrays in one message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Names of the types that a page knows, by those of NumPy.
_TYPES = {"float32": "<f4", "uint32": "<u4", "uint8": "|u1", "int8": "|i1"}


def joined(arrays: Mapping[str, NDArray[Any]]) -> tuple[bytes, list[dict[str, Any]]]:
    """The arrays one after the other, each from a multiple of eight bytes on, and a table of name, type, shape and
    offset. 64-bit numbers are shortened to 32 bits."""
    parts: list[bytes] = []
    table = []
    offset = 0
    for name, array in arrays.items():
        kind = {"float64": "float32", "int64": "uint32", "uint64": "uint32", "bool": "uint8"}.get(
            array.dtype.name, array.dtype.name
        )
        data = np.ascontiguousarray(array, dtype=_TYPES[kind]).tobytes()
        table.append({"name": name, "type": kind, "shape": list(array.shape), "offset": offset})
        data += b"\0" * (-len(data) % 8)
        parts.append(data)
        offset += len(data)
    return b"".join(parts), table
