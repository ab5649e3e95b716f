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
#: Distinct powers are numbered if there are at most this many per particle; with more, codes are shorter.
_REPEATED = 0.25


def encode_packed(
    rows: Rows, order: NDArray[np.uint32], keys: NDArray[np.uint64], coder_name: str, grid: Grid, with_paths: bool
) -> Chunk:
    """The rows in ``order``, whose ``keys`` ascend."""
    loops, places, surfaces, n = kernels(), ordering(), grid.surfaces, len(order)
    directions, paths, bounces = (np.empty(n, np.uint32) for _ in range(3))
    box, flux, part = np.empty(6), np.empty(3), np.empty((n, WORDS), np.uint32)
    loops.gathered(rows, order, part)
    has_frames = loops.pack(
        *(part, part.view(np.float32), keys, surfaces.frames, grid.bits, grid.position_bound),
        *(directions, paths, bounces, box, flux),
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
    positions = "frames"
    chosen: list[int] = []
    if not has_frames:
        shapes = np.repeat(surfaces.shape_of(numbers), counts)
        positions, chosen = _add_positions(packing, part[:, columns_of("position")], shapes, grid)
    planes = np.empty((3, n), np.uint8)
    loops.direction_planes(directions, *planes)
    for plane in planes:
        packing.add(plane)
    powers = _add_powers(packing, part, keys)
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
            "positions": positions,
            "differences": chosen,
            "powers": powers,
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
    loops.place(
        *(numbers, counts, codes, shapes.astype(np.uint32), primitives, grid.bits, grid.shape_bits, surfaces.frames),
        *(head["positions"] == "frames", rows, floats),
    )
    if head["positions"] == "boxes":
        own = np.repeat(shapes, counts)
        for axis, is_difference in enumerate(head["differences"]):
            levels = strips.planes(n)
            levels = summed(levels) if is_difference else levels
            floats[:, axis] = grid.low[own, axis] + levels * grid.coordinate_steps[own]
    elif head["positions"] == "plain":
        _read_columns(strips, rows, "position")
    loops.unpack_directions(strips.next(), strips.next(), strips.next(), floats)
    if head["powers"] == "palette":
        found = int(strips.next().view(np.uint32)[0])
        table = np.stack([strips.planes(found) for _ in range(3)], axis=1)
        rows[:, columns_of("power")] = table[strips.planes(n)]
    elif head["powers"] == "codes":
        loops.unpack_powers(strips.planes(n, np.uint64), floats)
    else:
        _read_columns(strips, rows, "power")
    rows[:, columns_of("bounce")] = strips.planes(n)[:, None]
    rows[:, columns_of("path")] = strips.planes(n)[:, None] if head["paths"] else 0
    return rows


def _add_positions(
    packing: Packing, position: NDArray[np.uint32], shapes: NDArray[np.int64], grid: Grid
) -> tuple[str, list[int]]:
    """Add positions that do not follow from frames: as levels in the boxes of their shapes, or, if they lie outside,
    unchanged. Returns the name of the representation, and for each coordinate whether differences are stored."""
    with np.errstate(invalid="ignore", over="ignore"):
        levels = np.rint((position.view(np.float32) - grid.low[shapes]) / grid.coordinate_steps[shapes, None])
    if not ((levels >= 0) & (levels <= grid.MOST)).all():
        _add_columns(packing, position)
        return "plain", []
    chosen = []
    for values in levels.astype(np.uint32).T:
        steps = differences(np.ascontiguousarray(values))
        chosen.append(int(steps.sum(dtype=np.uint64) < values.sum(dtype=np.uint64)))
        packing.add_planes(steps if chosen[-1] else np.ascontiguousarray(values))
    return "boxes", chosen


def _add_powers(packing: Packing, part: Rows, keys: NDArray[np.uint64]) -> str:
    """Add powers: as numbers of their distinct values; if there are many, as codes; unchanged if a power has no code.
    Returns the name of the representation."""
    n = len(part)
    index, table = np.empty(n, np.uint32), np.empty((int(_REPEATED * n) + 1, 3), np.uint32)
    found = kernels().palette(part, index, table, np.empty(_SLOTS, np.int32))
    if found > 0:
        packing.add(np.array([found], np.uint32))
        _add_columns(packing, table[:found])
        packing.add_planes(index)
        return "palette"
    codes = np.empty(n, np.uint64)
    if kernels().power_codes(part, part.view(np.float32), keys, codes):
        packing.add_planes(codes)
        return "codes"
    _add_columns(packing, part[:, columns_of("power")])
    return "plain"


def _add_columns(packing: Packing, columns: NDArray[np.uint32]) -> None:
    for column in columns.T:
        packing.add_planes(np.ascontiguousarray(column))


def _read_columns(strips: Strips, rows: Rows, name: str) -> None:
    for column in range(*columns_of(name).indices(WORDS)):
        rows[:, column] = strips.planes(len(rows))
