"""Whether two runs estimate the same picture, by the variance that was measured, never by a fixed per cent."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

#: A run that agrees is called different with this probability.
LEVEL = 1e-5


def blocks(images: np.ndarray, size: int) -> np.ndarray:
    """Means over ``size`` x ``size`` pixels: sums of many paths are nearer to normal than those of one pixel."""
    n, h, w, c = images.shape
    h, w = h // size * size, w // size * size
    return images[:, :h, :w].reshape(n, h // size, size, w // size, size, c).mean(axis=(2, 4))


def z_scores(a: np.ndarray, b: np.ndarray | float) -> np.ndarray:
    """Welch's statistic of the means over axis 0, brought to a standard normal. ``b`` may be a known value."""
    difference, variance, parts = a.mean(0), a.var(0, ddof=1) / len(a), []
    parts.append(variance**2 / (len(a) - 1))
    if isinstance(b, np.ndarray):
        other = b.var(0, ddof=1) / len(b)
        difference, variance = difference - b.mean(0), variance + other
        parts.append(other**2 / (len(b) - 1))
    else:
        difference = difference - b
    # Where neither run scatters, rounding is all the difference there is.
    floor = (1e-5 * np.abs(a.mean(0)) + 1e-7) ** 2
    variance = np.maximum(variance, floor)
    freedom = np.clip(variance**2 / np.maximum(sum(parts), 1e-300), 1.0, 1e6)
    t = difference / np.sqrt(variance)
    return np.sign(t) * stats.norm.isf(np.maximum(stats.t.sf(np.abs(t), freedom), 1e-300))


class TooNoisy(AssertionError):
    """A comparison whose runs are too short for the precision that it needs."""


def assert_agree(a: np.ndarray, b: np.ndarray | float, what: Any = "", block: int = 4, precision: float = 0.02) -> None:
    """Two stacks of pass pictures (passes, h, w, c), or one and the true value, have the same mean.

    Two tests a channel: the sum over the picture, and chi-square of the blocks' z. ``precision`` is the largest
    relative standard error of the sum with which the comparison still says something; :class:`TooNoisy` beyond it.
    """
    total_a, total_b = a.mean(axis=(1, 2)), b.mean(axis=(1, 2)) if isinstance(b, np.ndarray) else b
    scale = np.abs(total_a.mean(0)).max()
    assert scale > 0.0, f"{what}: black"
    for name, total in (("", total_a), ("the reference is ", total_b)):
        if isinstance(total, np.ndarray):
            error = total.std(0, ddof=1) / np.sqrt(len(total))
            if not (error <= precision * scale).all():
                raise TooNoisy(f"{what}: {name}too noisy to say anything, {error / scale}")
    z_total = z_scores(total_a, total_b)
    p_total = 2.0 * stats.norm.sf(np.abs(z_total)).min()
    z = z_scores(blocks(a, block), blocks(b, block) if isinstance(b, np.ndarray) else b)
    # Where next to nothing arrives, a few rare paths do all of it, and their mean over six passes is not normal. Where
    # one of both pictures is lit, the other may not be black.
    lit = blocks(a, block).mean(axis=(0, 3)) > 1e-3 * scale
    lit |= blocks(b, block).mean(axis=(0, 3)) > 1e-3 * scale if isinstance(b, np.ndarray) else b > 1e-3 * scale
    z = np.where(lit[..., None], z, 0.0)
    count = int(lit.sum())
    chi_square = (z**2).sum(axis=(0, 1))
    p_blocks = stats.chi2.sf(chi_square, count).min()
    mean_b = total_b.mean(0) if isinstance(total_b, np.ndarray) else total_b
    report = (
        f"{what}: means {total_a.mean(0)} and {mean_b}, z of the sum {np.round(z_total, 2)} (p {p_total:.1e}); "
        f"chi-square per block {np.round(chi_square / count, 2)} of {count} (p {p_blocks:.1e}), "
        f"z by block (first channel)\n{np.round(z[..., 0], 1)}"
    )
    assert p_total > LEVEL, report
    assert p_blocks > LEVEL, report


def assert_mean(samples: np.ndarray, expected: float, what: Any = "", sigmas: float = 4.5) -> None:
    """The mean of many independent samples is ``expected`` within ``sigmas`` of its standard error."""
    samples = np.asarray(samples, np.float64)
    error = samples.std(ddof=1) / np.sqrt(samples.size)
    mean = samples.mean()
    assert abs(mean - expected) <= sigmas * error + 1e-4 * abs(expected), (
        f"{what}: {mean:.6g} ± {error:.2g}, expected {expected:.6g}"
    )
