"""`etendue points`: lists point sets, writes their points, measures discrepancies, plots projections."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from etendue.core import OptionError
from etendue.display import Projection, projection_plot
from etendue.film import write_bytes
from etendue.points import (
    PointSet,
    PointSetError,
    has_size,
    l2_discrepancy,
    point_set,
    point_sets,
    star_discrepancy,
    star_discrepancy_bounds,
)

from ..console import output_console, say

#: Default numbers of points of a plot or a measure, and of a list.
_PLOTTED, _LISTED = 1024, 16
#: Limit on the coordinates of pairs of points for an L2 discrepancy.
_MAX_PAIRS = 1 << 31
#: Rows that are written at a time.
_ROWS = 1 << 14


def show_point_sets() -> int:
    """Print a line for each point set."""
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "dimensions", "points", "seed", "what"):
        table.add_column(heading, no_wrap=heading != "what")
    for name, kind in point_sets().items():
        most = "any" if kind.max_dimension is None else str(kind.max_dimension)
        what = re.sub(r" ?\[[^]]*\]|``|:\w+:|`|\*\*", "", inspect.cleandoc(kind.__doc__ or "").partition("\n\n")[0])
        size = "fixed" if has_size(kind) else "sequence"
        table.add_row(name, most, size, "yes" if kind.is_random else "", " ".join(what.split()))
    output_console().print(table)
    say("\nNAME+shift moves a set at random, modulo 1. Its points: etendue points NAME; drawn: --plot FILE.svg")
    return 0


def show_points(
    name: str,
    *,
    count: int | None,
    dimension: int | None,
    first: int,
    seed: int,
    measure: bool,
    plot: Path | None,
    pairs: Sequence[str],
) -> int:
    """Points as CSV, or their discrepancies, or a plot. Raises :class:`OptionError`."""
    if measure and plot is not None:
        raise OptionError("--measure and --plot exclude each other; a plot shows the discrepancy of each pair")
    chosen = [parse_pair(text) for text in pairs]
    if chosen and plot is None:
        raise OptionError("--pair selects the dimensions of --plot; give --plot FILE.svg")
    count = count or (_PLOTTED if measure or plot else _LISTED)
    dimension = dimension or max([2, *(1 + max(pair) for pair in chosen)])
    points = point_set(name, dimension, first + count, seed)
    if plot is not None:
        _draw(points, plot, chosen or [(0, 1)], range(first, first + count))
    elif measure:
        _show_measures(points.block(count, first))
    else:
        say(",".join(["index", *(f"x{d}" for d in range(dimension))]))
        for start in range(first, first + count, _ROWS):
            block = points.block(min(_ROWS, first + count - start), start)
            say("\n".join(",".join([str(start + i), *(repr(float(v)) for v in row)]) for i, row in enumerate(block)))
    return 0


def parse_pair(text: str) -> tuple[int, int]:
    """Two dimensions from ``10,11``. Raises :class:`OptionError`."""
    match = re.match(r"^\s*(\d+)\s*,\s*(\d+)\s*$", text)
    if match is None:
        raise OptionError(f"--pair needs two dimensions such as 0,1, counted from 0, not '{text}'")
    return int(match[1]), int(match[2])


def _draw(points: PointSet, target: Path, pairs: Sequence[tuple[int, int]], indices: range) -> None:
    if target.suffix.lower() != ".svg":
        raise OptionError(f"--plot writes .svg, not '{target}'")
    index = np.arange(indices.start, indices.stop)
    panels = []
    for a, b in pairs:
        x, y = points.coordinate(index, a), points.coordinate(index, b)
        panels.append(Projection(x, y, f"dimension {a}", f"dimension {b}", _evenness(x, y)))
    title = f"{points.name}, {len(indices)} points from {indices.start}"
    write_bytes(target, projection_plot(panels, title).encode())
    say(str(target))


def _evenness(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    points = np.stack([x, y], axis=-1)
    if len(points) > 4096:
        low, high = star_discrepancy_bounds(points)
        return f"D* {low:.4f} to {high:.4f}"
    return f"D* {star_discrepancy(points):.4f}"


def _show_measures(points: NDArray[np.float64]) -> None:
    table = Table(box=None, pad_edge=False, show_header=False)
    try:
        table.add_row("star discrepancy", f"{star_discrepancy(points):.6g}")
    except PointSetError:
        try:
            low, high = star_discrepancy_bounds(points)
            table.add_row("star discrepancy", f"{low:.6g} to {high:.6g}")
        except PointSetError:
            table.add_row("star discrepancy", "no bound in so many dimensions")
    if len(points) ** 2 * points.shape[1] <= _MAX_PAIRS:
        for kind in ("star", "centered", "wrap", "mixture"):
            table.add_row(f"L2 {kind}", f"{l2_discrepancy(points, kind):.6g}")
    else:
        table.add_row("L2", "not for so many points: it visits every pair")
    output_console().print(table)
