"""Chunks of particles without loss."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..particles import WORDS, Rows, columns_of
from .grid import Grid
from .strips import Chunk, Packing, Strips, differences, kernels, summed


def encode_raw(rows: Rows, coder_name: str) -> Chunk:
    """Rows as they are."""
    packing = Packing(coder_name)
    packing.add(rows)
    return packing.chunk(_head(rows, "raw"))


def decode_raw(head: dict[str, Any], strips: Strips, grid: Grid) -> Rows:
    """Inverse of :func:`encode_raw`."""
    return strips.next().view(np.uint32).reshape(int(head["count"]), WORDS)


def encode_exact(rows: Rows, order: NDArray[np.uint32], coder_name: str) -> Chunk:
    """The rows in ``order``, each column in planes of bytes, as differences of neighbours if these are smaller."""
    part, packing, chosen = np.empty((len(order), WORDS), np.uint32), Packing(coder_name), []
    kernels().gathered(rows, order, part)
    for column in range(WORDS):
        values = np.ascontiguousarray(part[:, column])
        steps = differences(values)
        chosen.append(int(steps.sum(dtype=np.uint64) < values.sum(dtype=np.uint64)))
        packing.add_planes(steps if chosen[-1] else values)
    return packing.chunk(_head(part, "exact") | {"differences": chosen})


def decode_exact(head: dict[str, Any], strips: Strips, grid: Grid) -> Rows:
    """Inverse of :func:`encode_exact`."""
    rows = np.empty((int(head["count"]), WORDS), np.uint32)
    for column, is_difference in enumerate(head["differences"]):
        values = strips.planes(len(rows))
        rows[:, column] = summed(values) if is_difference else values
    return rows


def _head(rows: Rows, kind: str) -> dict[str, Any]:
    position, power = (rows[:, columns_of(name)].view(np.float32) for name in ("position", "power"))
    shapes, counts = np.unique(rows[:, columns_of("shape")], return_counts=True)
    return {
        "kind": kind,
        "count": len(rows),
        "box": [*map(float, position.min(0)), *map(float, position.max(0))],
        "power": [float(x) for x in power.sum(0, dtype=np.float64)],
        "shapes": [[int(s), int(n)] for s, n in zip(shapes, counts, strict=True)],
    }
