"""Chunks of particles with bounded loss; see :mod:`.codecs`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..particles import WORDS, Rows, columns_of
from .grid import Grid
from .strips import Chunk, Packing, Strips, differences, kernels, ordering, summed

#: Slots of the table in which distinct powers are found, more than a chunk has particles.
_SLOTS = 1 << 17
#: Distinct powers are numbered if there are at most so many, relative to the particles.
_REPEATED = 0.4


def encode_packed(
    rows: Rows, order: NDArray[np.uint32], keys: NDArray[np.uint64], coder_name: str, grid: Grid, with_paths: bool
) -> Chunk:
    """The rows in ``order``, whose ``keys`` ascend."""
    loops, places, surfaces, n = kernels(), ordering(), grid.surfaces, len(order)
    directions, powers = np.empty(n, np.uint32), np.empty(n, np.uint64)
    paths, bounces = np.empty(n, np.uint32), np.empty(n, np.uint32)
    box, flux, part = np.empty(6), np.empty(3), np.empty((n, WORDS), np.uint32)
    loops.gathered(rows, order, part)
    has_frames, has_codes = loops.pack(
        *(part, part.view(np.float32), keys, surfaces.frames, grid.bits, grid.position_bound),
        *(directions, powers, paths, bounces, box, flux),
    )
    packing = Packing(coder_name)
    numbers, counts = np.empty(n, np.int64), np.empty(n, np.int64)
    runs = places.runs_of(keys, numbers, counts)
    numbers, counts = numbers[:runs], counts[:runs]
    gaps, codes = np.empty(n, np.uint64), np.empty(8 * n + 64, np.uint8)
    places.gaps_of(keys, counts, gaps)
    packing.add_planes(np.diff(numbers, prepend=0).astype(np.uint64))
    packing.add_planes(counts.astype(np.uint64))
    packing.add(codes[: places.rice(gaps, codes)])
    if not has_frames:
        position = part[:, columns_of("position")].view(np.float32)
        for steps in np.rint((position - box[:3]) / grid.position_step).astype(np.uint32).T:
            packing.add_planes(differences(np.ascontiguousarray(steps)))
    planes = np.empty((3, n), np.uint8)
    loops.direction_planes(directions, *planes)
    for plane in planes:
        packing.add(plane)
    if has_codes:
        _add_powers(packing, powers)
    else:
        for column in part[:, columns_of("power")].T:
            packing.add_planes(np.ascontiguousarray(column))
    packing.add_planes(bounces)
    if with_paths:
        packing.add_planes(paths)
    per_shape = np.bincount(surfaces.shape_of(numbers), counts, len(surfaces)).astype(np.int64)
    return packing.chunk(
        {
            "kind": "packed",
            "count": n,
            "runs": runs,
            "box": [float(x) for x in box],
            "power": [float(x) for x in flux],
            "shapes": [[int(s), int(per_shape[s])] for s in np.flatnonzero(per_shape)],
            "frames": int(has_frames),
            "codes": int(has_codes),
            "paths": int(with_paths),
        }
    )


def decode_packed(head: dict[str, Any], strips: Strips, grid: Grid) -> Rows:
    """Inverse of :func:`encode_packed`. Raises ``ValueError`` if the strips do not fit each other."""
    loops, places, surfaces = kernels(), ordering(), grid.surfaces
    n, runs = int(head["count"]), int(head["runs"])
    rows = np.empty((n, WORDS), np.uint32)
    floats = rows.view(np.float32)
    numbers = np.cumsum(strips.planes(runs, np.uint64).astype(np.int64))
    counts = strips.planes(runs, np.uint64).astype(np.int64)
    gaps, codes = np.empty(n, np.uint64), np.empty(n, np.uint32)
    if not places.unrice(strips.next(), gaps) or not places.merged_gaps(counts, gaps, codes):
        raise ValueError("gaps and runs do not fit")
    if numbers.min() < 0 or numbers.max() >= surfaces.total:
        raise ValueError("a primitive that does not exist")
    shapes = surfaces.shape_of(numbers)
    primitives = (numbers - surfaces.first[shapes]).astype(np.uint32)
    has_frames = bool(head["frames"])
    loops.place(
        *(numbers, counts, codes, shapes.astype(np.uint32), primitives, grid.bits, surfaces.frames, has_frames),
        *(rows, floats),
    )
    if not has_frames:
        for axis in range(3):
            floats[:, axis] = head["box"][axis] + summed(strips.planes(n)) * grid.position_step
    loops.unpack_directions(strips.next(), strips.next(), strips.next(), floats)
    if head["codes"]:
        loops.unpack_powers(_powers(strips, n), floats)
    else:
        for column in range(*columns_of("power").indices(WORDS)):
            rows[:, column] = strips.planes(n)
    rows[:, columns_of("bounce")] = strips.planes(n)[:, None]
    rows[:, columns_of("path")] = strips.planes(n)[:, None] if head["paths"] else 0
    return rows


def _add_powers(packing: Packing, powers: NDArray[np.uint64]) -> None:
    """Power codes as numbers of their distinct values, or, if these are many, as they are."""
    index, table = np.empty(len(powers), np.uint32), np.empty(int(_REPEATED * len(powers)) + 1, np.uint64)
    found = kernels().palette(powers, index, table, np.empty(_SLOTS, np.int32))
    packing.add(np.array([max(found, 0)], np.uint32))
    if found > 0:
        packing.add_planes(table[:found])
        packing.add_planes(index)
    else:
        packing.add_planes(powers)


def _powers(strips: Strips, count: int) -> NDArray[np.uint64]:
    found = int(strips.next().view(np.uint32)[0])
    if not found:
        return strips.planes(count, np.uint64)
    table = strips.planes(found, np.uint64)
    return np.asarray(table[strips.planes(count)])
