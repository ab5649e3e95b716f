"""How finely the regions of a box should be divided in hierarchical multipath: what they tell about the lines that
pass, and the errors of solutions (the future work of the thesis, section 7.2.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import typer

from etendue.core import Array
from etendue.radiosity.hierarchical_multipath.lists import Lists

from ..measuring import Record
from ..options import Out, Seeds
from .boxes import BOTH, Room, Rooms, _quotient
from .options import OUT
from .references import mean_squared_error

#: Grid, sectors and rings that are tried; the one of the thesis is the base.
RESOLUTIONS = (
    *((1, 1, 1), (2, 1, 1), (2, 4, 2), (4, 1, 1), (4, 4, 2), (4, 8, 4), (8, 1, 1), (8, 4, 2), (8, 8, 4), (16, 4, 2)),
)
THESIS = (4, 4, 2)
#: N of the lines that tell information, in those of the runs; passes of a reference.
_MORE, _PASSES = 16, 8


def kept_information(lists: Lists) -> tuple[float, float]:
    """(bits that the region of a line tells about whether it passes the box, bits that the line itself tells).

    With the share T of lines that pass and T_r in region r, the first is the mutual information
    H(T) - sum p_r H(T_r), and the second H(T), because a line passes or does not. The estimate from counts is too high
    by 1 / (2 n ln 2) for each region beyond the first, which is taken off (Miller, 1955).
    """
    through, passed = lists.through.astype(float), (lists.through - lists.hitting).astype(float)
    crossed = through > 0
    total = through.sum()
    whole = float(_entropy(passed.sum() / total))
    left = float((through[crossed] * _entropy(passed[crossed] / through[crossed])).sum() / total)
    bias = (np.count_nonzero(crossed) - 1) / (2 * total * np.log(2))
    return whole - left - bias, whole


def _entropy(share: Array | float) -> Array:
    p = np.clip(share, 1e-300, 1.0)
    q = np.clip(1.0 - np.asarray(share), 1e-300, 1.0)
    result: Array = -(p * np.log2(p) + q * np.log2(q))
    return result


@dataclass
class _Tried:
    shares: list[float] = field(default_factory=list)  #: of information that is kept, by box
    bias: float = 0.0
    errors: list[list[float]] = field(default_factory=list)


def measure(
    scenes: Rooms = BOTH,
    lines: Annotated[int, typer.Option(min=1, help="N.")] = 1 << 16,
    seeds: Seeds = 10,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene: what regions keep, and the errors of multipath."""
    for name in scenes:
        yield _measure(Room.of(name), lines, seeds)


def _measure(room: Room, lines: int, seeds: int) -> Record:
    halves = [room.solved(room.method(False, 4 * lines, seed=9000 + half), _PASSES) for half in range(2)]
    exact, noise = np.mean(halves, axis=0), mean_squared_error(room.patches, *halves) / 4
    found = {resolution: _try(room, resolution, lines, seeds, exact) for resolution in RESOLUTIONS}
    base = np.array(found[THESIS].errors)
    record = Record(
        f"Resolution of boxes, {room.title}, N = {lines}, {seeds} seeds",
        ("places x directions", "regions", "information kept", "MSE of the mean", "MSE of a run", "to the thesis's"),
    )
    for resolution, tried in found.items():
        grid, sectors, rings = resolution
        errors = np.array(tried.errors)
        record.add(
            f"{grid}x{grid} x {sectors * rings}",
            str(6 * grid * grid * sectors * rings),
            ", ".join(f"{share:.0%}" for share in tried.shares),
            f"{tried.bias:.4g}",
            f"{errors.mean():.4g}",
            "1" if resolution == THESIS else _quotient(errors, base),
        )
    record.notes += [
        "information kept: mutual information of a line's region and of whether it passes, over the entropy of the "
        f"latter, for each box, from lines of N = {_MORE * lines}",
        f"errors against flat multipath by {2 * _PASSES} passes of N = {4 * lines}, whose own error, {noise:.2g}, is "
        "not taken off; of the mean of all runs, which has the bias and little noise, and of single runs",
    ]
    return record


def _try(room: Room, resolution: Sequence[int], lines: int, seeds: int, exact: Array) -> _Tried:
    options = dict(zip(("grid", "sectors", "rings"), resolution, strict=True))
    tried = _Tried()
    for part, lists in room.method(True, _MORE * lines, seed=77, **options).cast_lines().items():
        if part is not room.boxed:
            kept, whole = kept_information(lists)
            tried.shares.append(kept / whole)
    runs = [room.solved(room.method(True, lines, seed=seed + 1, **options)) for seed in range(seeds)]
    tried.errors = [[mean_squared_error(room.patches, run, exact)] for run in runs]
    tried.bias = mean_squared_error(room.patches, np.mean(runs, axis=0), exact)
    return tried
