"""Diagnosis of Markov chains: autocorrelation time, effective sample size, split R-hat, burn-in.

Numbers have the shape (chains, steps): several chains of the same length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.core import Array

from .errors import IntegrationError

#: A window of autocorrelations ends where it is this many autocorrelation times long [Sokal 1997].
_WINDOW = 5.0


@dataclass(frozen=True)
class ChainDiagnosis:
    """Diagnosis of a quantity along chains.

    Attributes
    ----------
    mean, standard_error: of the quantity; the error allows for the dependence of neighbours.
    autocorrelation_time: integrated, in steps: the number of steps equivalent to one independent number.
    effective_samples: number of independent numbers with the same error of the mean.
    r_hat: split R-hat [Gelman 1992; Vehtari 2021]; 1 if halves of chains agree, above about 1.01 if they do not yet.
    """

    mean: float
    standard_error: float
    autocorrelation_time: float
    effective_samples: float
    r_hat: float


def autocorrelation(values: Array) -> Array:
    """Autocorrelation at lags 0 … steps-1, averaged over the chains: (steps,). It is relative to the mean of all
    chains, so that chains stuck in different places count as correlated. Constant numbers give 1 at lag 0, else 0."""
    v = _checked(values)
    steps = v.shape[1]
    centred = v - v.mean()
    size = 1 << (2 * steps - 1).bit_length()  # zero padding against the periodicity of the transform
    spectrum = np.zeros(size // 2 + 1)
    for row in centred:
        spectrum += np.abs(np.fft.rfft(row, size)) ** 2
    covariance = np.fft.irfft(spectrum, size)[:steps] / v.size
    if covariance[0] <= 1e-24 * max(float(np.mean(v * v)), np.finfo(float).tiny):
        return np.concatenate([[1.0], np.zeros(steps - 1)])
    result: Array = covariance / covariance[0]
    return result


def autocorrelation_time(values: Array) -> float:
    """Integrated autocorrelation time ``1 + 2 sum rho_t`` in steps, over a window of five such times [Sokal 1997].

    Numbers that are anticorrelated have less than 1.
    """
    times = 2 * np.cumsum(autocorrelation(values)) - 1
    enough = np.flatnonzero(np.arange(len(times)) >= _WINDOW * np.maximum(times, 1.0))
    return float(max(times[enough[0] if len(enough) else -1], 1.0 / np.asarray(values).size))


def split_r_hat(values: Array) -> float:
    """Split R-hat of halved chains: root of the ratio of the total variance to that within halves [Gelman 1992]."""
    v = _checked(values)
    half = v.shape[1] // 2
    if half < 2:
        raise IntegrationError(f"{v.shape[1]} steps are too few to compare halves of chains: at least 4")
    halves = np.concatenate([v[:, :half], v[:, -half:]])
    within = float(halves.var(axis=1, ddof=1).mean())
    between = float(halves.mean(axis=1).var(ddof=1))
    if within <= 0:
        return 1.0 if between <= 0 else float("inf")
    return float(np.sqrt((half - 1) / half + between / within))


def diagnose(values: Array) -> ChainDiagnosis:
    """The diagnosis of (chains, steps) numbers."""
    v = _checked(values)
    time = autocorrelation_time(v)
    effective = v.size / time
    error = float(np.sqrt(v.var() / effective))
    return ChainDiagnosis(float(v.mean()), error, time, effective, split_r_hat(v))


def burn_in(values: Array) -> int:
    """Number of first steps to discard, at most half of all: it minimises the standard error of the mean of the other
    steps, computed as for independent numbers (the MSER rule [White 1997])."""
    v = _checked(values).mean(axis=0)
    steps = len(v)
    left = np.arange(steps, 0, -1)
    total, squares = np.cumsum(v[::-1])[::-1], np.cumsum((v * v)[::-1])[::-1]
    statistic = (squares / left - (total / left) ** 2) / left
    return int(np.argmin(statistic[: max(steps // 2, 1)]))


def _checked(values: Array) -> Array:
    v = np.asarray(values, dtype=np.float64)
    if v.ndim == 1:
        v = v[None, :]
    if v.ndim != 2 or v.shape[1] < 2:
        raise IntegrationError(f"chains are numbers of shape (chains, steps), at least 2 steps, not {v.shape}")
    if not np.isfinite(v).all():
        raise IntegrationError("numbers along a chain must be finite")
    return v
