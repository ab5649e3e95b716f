"""Tests of point sets: whether they are nets, and the uniformity of consecutive numbers of a stream."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .pointset import PointSetError


def net_parameter(points: ArrayLike, base: int = 2) -> int:
    """The smallest ``t`` for which ``points`` are a (t, m, s)-net in ``base`` [Niederreiter 1992].

    points: (base^m, s) in [0, 1). In a (t, m, s)-net every elementary interval of volume ``base^(t-m)``, a product of
    ``[a_j / base^k_j, (a_j + 1) / base^k_j)``, holds exactly ``base^t`` points. Any set is one with ``t = m``.
    Raises :class:`PointSetError` if the number of points is not a power of ``base``.
    """
    x = np.asarray(points, np.float64)
    if x.ndim != 2:
        raise PointSetError(f"points must be an array (n, s), not one of shape {x.shape}")
    n, s = x.shape
    m = round(np.log(max(n, 1)) / np.log(base))
    if base**m != n:
        raise PointSetError(f"a net in base {base} has a power of {base} points, not {n}")
    # Numbers such as 1/3 are not exact; therefore a small value is added before truncation.
    cells = np.floor(x * n + 1e-9 * n).astype(np.int64)
    for t in range(m):
        if all(_is_even(cells, splits, base, m, t) for splits in _compositions(m - t, s)):
            return t
    return m


def _is_even(cells: NDArray[np.int64], splits: tuple[int, ...], base: int, m: int, t: int) -> bool:
    place = np.zeros(len(cells), np.int64)
    for j, split in enumerate(splits):
        place = place * base**split + cells[:, j] // base ** (m - split)
    return bool((np.bincount(place, minlength=base ** (m - t)) == base**t).all())


def _compositions(total: int, parts: int) -> Iterator[tuple[int, ...]]:
    if parts == 1:
        yield (total,)
        return
    for first in range(total + 1):
        for rest in _compositions(total - first, parts - 1):
            yield (first, *rest)


def consecutive(values: ArrayLike, k: int, *, overlapping: bool = False) -> NDArray[np.float64]:
    """Points (n, k) of ``k`` consecutive numbers of a stream, disjoint or ``overlapping``.

    A stream of points, (n, s), is read number by number. Good point sets are *not* good streams; see docs/points.md.
    """
    stream = np.asarray(values, np.float64).ravel()
    if k < 1 or len(stream) < k:
        raise PointSetError(f"k must be from 1 to the {len(stream)} numbers of the stream, not {k}")
    if overlapping:
        return np.lib.stride_tricks.sliding_window_view(stream, k).copy()
    return stream[: len(stream) // k * k].reshape(-1, k)


def uniformity_score(points: ArrayLike, cells: int | None = None) -> float:
    """Deviation of the counts of ``points``, (n, k), in ``cells^k`` equal cubes from those of independent uniform
    points.

    The chi-square statistic in standard deviations [Wilson 1931]: between about -4 and 4 for independent uniform
    points, far above for points that are not uniform in ``k`` dimensions, far below for low-discrepancy points. By
    default a cube has at least 10 points on average. For :func:`consecutive` numbers it tests whether a stream is
    k-uniform.
    """
    x = np.asarray(points, np.float64)
    if x.ndim == 1:
        x = x[:, None]
    n, k = x.shape
    cells = max(2, int((n / 10) ** (1 / k) + 1e-9)) if cells is None else cells
    if cells < 2 or cells**k > 1 << 24:
        raise PointSetError(f"{cells}^{k} cubes: a dimension needs at least 2, and all together are at most 2^24")
    place = np.zeros(n, np.int64)
    for j in range(k):
        place = place * cells + np.minimum((x[:, j] * cells).astype(np.int64), cells - 1)
    expected, freedom = n / cells**k, cells**k - 1
    statistic = float(((np.bincount(place, minlength=cells**k) - expected) ** 2).sum() / expected)
    width = 2 / (9 * freedom)
    return float(((statistic / freedom) ** (1 / 3) - (1 - width)) / np.sqrt(width))
