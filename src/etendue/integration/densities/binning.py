"""Adaptation of bins: smoothing and damping of their values, and new borders.

All functions act on the last axis, so that many rows of bins are treated at once.
"""

from __future__ import annotations

import numpy as np

from etendue.core import Array


def rebin(edges: Array, values: Array) -> Array:
    """New borders between which the ``values`` have equal sums; the ends stay fixed.

    ``edges`` is (..., K+1), ``values`` (..., K), not negative; within an old bin a value is spread evenly. Rows whose
    values are all zero keep their borders. [Lepage 1978; Leeson 2001, fig. 5.18]
    """
    flat_edges = np.asarray(edges, dtype=np.float64).reshape(-1, edges.shape[-1])
    flat_values = np.asarray(values, dtype=np.float64).reshape(-1, values.shape[-1])
    moved = flat_edges.copy()
    for row, (old, value) in enumerate(zip(flat_edges, flat_values, strict=True)):
        moved[row] = split_equally(old, value, len(value))
    return moved.reshape(edges.shape)


def split_equally(edges: Array, values: Array, parts: int) -> Array:
    """Borders (parts + 1) of ``parts`` bins that share the sum of ``values`` (K,) between ``edges`` (K+1,) equally."""
    # Relative to the largest value, so that sums of tiny values do not vanish.
    largest = float(np.max(values))
    reached = np.concatenate([[0.0], np.cumsum(values / largest)]) if largest > 0 else np.zeros(2)
    if not reached[-1] > 0 or not np.isfinite(reached[-1]):
        return np.interp(np.linspace(0, 1, parts + 1), np.linspace(0, 1, len(edges)), edges)
    borders = np.interp(np.linspace(0.0, reached[-1], parts + 1), reached, edges)
    borders[0], borders[-1] = edges[0], edges[-1]
    return borders


def smooth(values: Array, axis: int = -1) -> Array:
    """Mean over each bin of the linear interpolation between the centres of the bins: an eighth of either neighbour and
    three quarters of the bin's value; constant beyond the ends [Leeson 2001, sec. 5.5.1].

    The mean of three neighbours [Lepage 1978] smooths more, but inverts the sign of alternating values: in a long run
    borders then drift away from their optimum.
    """
    v = np.moveaxis(np.asarray(values, dtype=np.float64), axis, -1)
    result = 0.75 * v
    result[..., 1:] += v[..., :-1] / 8
    result[..., :-1] += v[..., 1:] / 8
    result[..., 0] += v[..., 0] / 8
    result[..., -1] += v[..., -1] / 8
    return np.moveaxis(result, -1, axis)


def damp(values: Array, alpha: float) -> Array:
    """``((1 - d) / ln(1 / d))^alpha`` of the shares ``d`` of each value in its row.

    [Lepage 1978; Leeson 2001, sec. 5.5.1] It reduces the ratio of large to small shares; zero stays zero.
    """
    v = np.asarray(values, dtype=np.float64)
    total = v.sum(axis=-1, keepdims=True)
    share = np.divide(v, total, out=np.zeros_like(v), where=total > 0)
    inside = (share > 0) & (share < 1)
    d = np.where(inside, share, 0.5)
    return np.where(inside, ((1 - d) / -np.log(d)) ** alpha, np.where(share >= 1, 1.0, 0.0))
