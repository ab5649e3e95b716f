"""Discrepancies of point sets: the star discrepancy, exact or with bounds, and the L2 discrepancies.

The star discrepancy is the largest difference between the share of points in a box with a corner at the origin and the
box's volume. By the Koksma-Hlawka inequality, the error of a mean is at most the star discrepancy times the variation
of the integrand [Niederreiter 1992].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, suggest

from .pointset import PointSetError

#: Limit on the boxes that :func:`star_discrepancy` visits (seconds), and on the cells of the grid of the bounds.
MAX_BOXES = 1 << 29
_MAX_CELLS = 1 << 22
#: Pairs of points that are processed together, so that they fit into a cache.
_BLOCK = 1 << 15


def star_discrepancy(points: ArrayLike) -> float:
    """The exact star discrepancy of ``points``, (n, d) in [0, 1].

    The time is that of visiting about ``n^d`` critical boxes. Raises :class:`PointSetError` if these are more than 2^29
    (20000 points in two dimensions, 800 in three, 150 in four); :func:`star_discrepancy_bounds` has no such limit.
    """
    x = _checked(points)
    n, d = x.shape
    if d == 1:
        ordered, rank = np.sort(x[:, 0]), np.arange(n)
        return float(np.maximum((rank + 1) / n - ordered, ordered - rank / n).max())
    if (n + 1) ** d > MAX_BOXES:
        raise PointSetError(
            f"the exact star discrepancy of {n} points in {d} dimensions needs {n + 1}^{d} boxes, but the limit is "
            f"{MAX_BOXES}; use fewer points or star_discrepancy_bounds"
        )
    # A sweep along the first dimension; counts for every corner in the others, of closed boxes and of open ones.
    grids = [np.append(np.unique(x[:, j]), 1.0) for j in range(1, d)]
    area = _volumes(grids)
    closed, inside = np.zeros(area.shape), np.zeros(area.shape)
    ranks = [np.searchsorted(grid, x[:, j + 1]) for j, grid in enumerate(grids)]
    order = np.argsort(x[:, 0], kind="stable")
    worst, done = 0.0, 0
    while done < n:
        side = x[order[done], 0]
        worst = max(worst, float((side * area - inside).max()))
        while done < n and x[order[done], 0] == side:
            corner = [rank[order[done]] for rank in ranks]
            closed[tuple(slice(r, None) for r in corner)] += 1 / n
            # At the corner 1, open and closed boxes have the same points.
            inside[tuple(slice(min(r + 1, len(g) - 1), None) for r, g in zip(corner, grids, strict=True))] += 1 / n
            done += 1
        worst = max(worst, float((closed - side * area).max()))
    return max(worst, float((area - inside).max()))


def star_discrepancy_bounds(points: ArrayLike, cells: int = _MAX_CELLS) -> tuple[float, float]:
    """A lower and an upper bound of the star discrepancy of ``points``, (n, d) in [0, 1].

    Boxes end at a grid of at most ``cells`` cells between quantiles of the coordinates. The bounds differ by about
    ``d cells^(-1/d)``. Raises :class:`PointSetError` if a dimension would have fewer than two cells.
    """
    x = _checked(points)
    n, d = x.shape
    per_axis = int(cells ** (1 / d) + 1e-9)
    if per_axis < 2:
        raise PointSetError(
            f"{cells} cells are too few to bound a discrepancy in {d} dimensions; use an L2 discrepancy"
        )
    grids = [np.unique(np.concatenate([[0.0, 1.0], _quantiles(x[:, j], per_axis - 1)])) for j in range(d)]
    # closed[k]: share of points <= the k-th corner; inside[k]: share of points < it.
    closed = _cumulative(x, grids, "left") / n
    inside = _cumulative(x, grids, "right") / n
    volume = _volumes(grids)
    upper_corner, lower_corner = (slice(1, None),) * d, (slice(None, -1),) * d
    lower = max(float((closed - volume).max()), float((volume - inside).max()))
    upper = max(
        float((closed[upper_corner] - volume[lower_corner]).max()),
        float((volume[upper_corner] - inside[lower_corner]).max()),
    )
    return min(lower, upper), min(upper, 1.0)


def l2_discrepancy(points: ArrayLike, kind: str = "centered") -> float:
    """An L2 discrepancy of ``points``, (n, d) in [0, 1]; the time is that of ``n^2 d`` operations.

    kind: ``star`` [Warnock 1972], ``centered`` or ``wrap`` [Hickernell 1998], ``mixture`` [Zhou 2013]. ``star`` is
    L2-star of ``scipy.stats.qmc.discrepancy``; the others are the square roots of its values.
    """
    if kind not in _KINDS:
        raise PointSetError(f"there is no discrepancy '{kind}'; {suggest(kind, _KINDS)}")
    x = _checked(points)
    n, d = x.shape
    constant, single, pair = _KINDS[kind]
    total = constant**d if kind != "wrap" else -(constant**d)
    if single is not None:
        total -= 2 / n * float(single(x).prod(axis=1).sum())
    return float(np.sqrt(max(total + _sum_over_pairs(x, pair) / n**2, 0.0)))


def _star_pair(a: Array, b: Array) -> Array:
    return 1 - np.maximum(a, b)


def _centered_pair(a: Array, b: Array) -> Array:
    return 1 + (np.abs(a - 0.5) + np.abs(b - 0.5) - np.abs(a - b)) / 2


def _wrap_pair(a: Array, b: Array) -> Array:
    gap = np.abs(a - b)
    return 1.5 - gap * (1 - gap)


def _mixture_pair(a: Array, b: Array) -> Array:
    gap = np.abs(a - b)
    return 15 / 8 - (np.abs(a - 0.5) + np.abs(b - 0.5)) / 4 - 0.75 * gap + gap * gap / 2


def _centered_single(x: Array) -> Array:
    z = np.abs(x - 0.5)
    return 1 + z / 2 - z * z / 2


def _mixture_single(x: Array) -> Array:
    z = np.abs(x - 0.5)
    return 5 / 3 - z / 4 - z * z / 4


def _star_single(x: Array) -> Array:
    return (1 - x * x) / 2


_Function = Callable[..., Array]
#: The factor of each dimension in the constant, in the sum over points, and in the sum over pairs.
_KINDS: dict[str, tuple[float, _Function | None, _Function]] = {
    "star": (1 / 3, _star_single, _star_pair),
    "centered": (13 / 12, _centered_single, _centered_pair),
    "wrap": (4 / 3, None, _wrap_pair),
    "mixture": (19 / 12, _mixture_single, _mixture_pair),
}


def _checked(points: ArrayLike) -> NDArray[np.float64]:
    x = np.asarray(points, np.float64)
    if x.ndim == 1:
        x = x[:, None]
    if x.ndim != 2 or not x.size:
        raise PointSetError(f"points must be an array (n, d) with at least one point, not one of shape {x.shape}")
    if not ((x >= 0) & (x <= 1)).all():
        raise PointSetError("a discrepancy needs points in the unit cube; some are outside or not finite")
    return x


def _sum_over_pairs(x: NDArray[np.float64], pair: _Function) -> float:
    """Sum over all ordered pairs of points of the product over the dimensions of ``pair``, which is symmetric."""
    total, start = 0.0, 0
    while start < len(x):
        end = start + max(1, _BLOCK // (len(x) - start))
        product = pair(x[start:end, :1], x[None, start:, 0])
        for j in range(1, x.shape[1]):
            product *= pair(x[start:end, j : j + 1], x[None, start:, j])
        # Pairs within the block are in the product twice, pairs with later points once.
        inside = product[:, : end - start].sum()
        total += float(2 * product.sum() - inside)
        start = end
    return total


def _quantiles(values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    ordered = np.sort(values)
    return ordered[np.linspace(0, len(values) - 1, min(count, len(values))).astype(int)]


def _volumes(grids: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    volume = np.ones(())
    for grid in grids:
        volume = volume[..., None] * grid
    return volume


def _cumulative(
    x: NDArray[np.float64], grids: list[NDArray[np.float64]], side: Literal["left", "right"]
) -> NDArray[np.float64]:
    """Number of points up to each corner: ``left`` includes those on the faces, ``right`` does not (except on faces at
    1)."""
    shape = tuple(len(grid) for grid in grids)
    places = []
    for j, grid in enumerate(grids):
        place = np.searchsorted(grid, x[:, j], side=side)
        places.append(np.minimum(place, len(grid) - 1))
    counts = np.bincount(np.ravel_multi_index(places, shape), minlength=int(np.prod(shape))).reshape(shape)
    for axis in range(len(shape)):
        counts = counts.cumsum(axis=axis)
    return counts.astype(np.float64)
