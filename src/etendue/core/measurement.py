"""Measurements of passes, which can be added; used by methods, engine and checkpoints.

A :class:`Measurement` has named sums, each with its own weight. It contains no means: only ``Method.develop`` divides.
``a + b`` is therefore the measurement of all passes of both, in any order. Adding an iteration twice is an error.
"""

from __future__ import annotations

import itertools
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .errors import EtendueError
from .log import logger
from .records import Record

Array = NDArray[np.float64]
#: Weight of a sum: a number, or one for each channel.
Weight: TypeAlias = float | Array

#: Ending of the name of a sum that is the difference of two independent halves of another one.
CONTRAST = " contrast"
#: Added to the squared reference in every relative error of the project (see :func:`Measurement.relative_error`).
RELATIVE_EPSILON = 0.01
#: Numbers that are squared at a time, so that they stay in the cache.
_BLOCK = 1 << 14


class Iterations:
    """A set of (replica, iteration) pairs, stored as sorted half-open intervals."""

    def __init__(self, intervals: dict[int, list[tuple[int, int]]] | None = None) -> None:
        self._intervals = {r: list(v) for r, v in (intervals or {}).items() if v}
        self._count = sum(b - a for spans in self._intervals.values() for a, b in spans)

    @classmethod
    def single(cls, iteration: int, replica: int = 0) -> Iterations:
        """The set of one iteration."""
        return cls({replica: [(iteration, iteration + 1)]})

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        for replica, spans in sorted(self._intervals.items()):
            for a, b in spans:
                for iteration in range(a, b):
                    yield replica, iteration

    def __contains__(self, item: object) -> bool:
        replica, iteration = item if isinstance(item, tuple) else (0, item)
        return any(a <= iteration < b for a, b in self._intervals.get(replica, ()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Iterations) and self._intervals == other._intervals

    def next_iteration(self, replica: int = 0) -> int:
        """The largest iteration of a replica plus 1, with which an interrupted run continues; 0 if there is none."""
        spans = self._intervals.get(replica)
        return spans[-1][1] if spans else 0

    def missing(self, replica: int = 0) -> Iterator[int]:
        """The iterations of a replica that are not in the set, in order, without end."""
        iteration = 0
        for a, b in self._intervals.get(replica, ()):
            yield from range(iteration, a)
            iteration = b
        yield from itertools.count(iteration)

    def union(self, other: Iterations) -> Iterations:
        """Disjoint union. Raises :class:`EtendueError` if an iteration is in both."""
        result = Iterations()
        result._intervals = dict(self._intervals)
        for replica, more in other._intervals.items():
            mine = self._intervals.get(replica, [])
            # Runs of thousands of workers have as many intervals, to which few are added at a time.
            few, many = sorted((mine, more), key=len)
            spans = list(many)
            for a, b in few:
                i = j = bisect_left(spans, (a, b))
                before = spans[i - 1] if i else (a - 1, a - 1)
                behind = spans[i] if i < len(spans) else (b + 1, b + 1)
                if before[1] > a or behind[0] < b:
                    twice = a if before[1] > a else behind[0]
                    raise EtendueError(
                        f"iteration {twice} of replica {replica} is in both measurements; each pass may be added once"
                    )
                if before[1] == a:
                    i, a = i - 1, before[0]
                if behind[0] == b:
                    j, b = j + 1, behind[1]
                spans[i:j] = [(a, b)]
            result._intervals[replica] = spans
        result._count = self._count + other._count
        return result

    def to_json(self) -> list[list[int]]:
        """Rows ``[replica, first, end]``, ``end`` excluded."""
        return [[r, a, b] for r, spans in sorted(self._intervals.items()) for a, b in spans]

    @classmethod
    def from_json(cls, rows: Iterable[Iterable[int]]) -> Iterations:
        """Inverse of :meth:`to_json`; rows in any order. Raises :class:`EtendueError` if they overlap."""
        result = cls()
        for replica, a, b in rows:
            result = result.union(cls({int(replica): [(int(a), int(b))]}))
        return result


class SquaresOf(Mapping[str, Array]):
    """The squares of the sums of one pass, made when they are asked for: to add them to others, no array is needed."""

    def __init__(self, sums: Mapping[str, Array], names: Iterable[str]) -> None:
        self._sums = {name: sums[name] for name in names}

    def __getitem__(self, name: str) -> Array:
        return np.square(self._sums[name], dtype=np.float64, order="C")

    def __contains__(self, name: object) -> bool:
        return name in self._sums

    def __iter__(self) -> Iterator[str]:
        return iter(self._sums)

    def __len__(self) -> int:
        return len(self._sums)

    def add_to(self, total: Array, name: str) -> None:
        """Add those of ``name`` to ``total``, C-contiguous, in place."""
        added, values = total.reshape(-1), self._sums[name].reshape(-1)
        for first in range(0, len(values), _BLOCK):
            part = values[first : first + _BLOCK].astype(np.float64)
            part *= part
            added[first : first + _BLOCK] += part


@dataclass
class Measurement:
    """Named sums of one or more passes.

    ``sums[name]`` is a host array of any shape (an image layer: height, width, channels), float64, or float32 for one
    pass, and ``develop`` divides it by ``weights[name]``. ``squares[name]``, of the same shape, float64, is the sum
    over passes of the squared sum of a pass, for quantities whose error is estimated. ``counters`` are totals (rays,
    paths, non-finite contributions, seconds).

    The other terms of the error are computed here: ``squared_weights[name]``, the sum over passes of the squared
    weight, and, if passes have different weights, ``products[name]``, the sum over passes of weight times sum.

    Passes that depend on each other have no such error. Instead, ``sums[name + CONTRAST]`` is the difference of two
    halves of ``sums[name]`` that are independent of each other in all passes, with the same weight.

    ``records[name]`` are rows that passes append, stored by pass and never summed: see :class:`Record`.
    """

    sums: dict[str, Array]
    weights: dict[str, Weight]
    iterations: Iterations
    squares: Mapping[str, Array] = field(default_factory=dict)
    counters: dict[str, float] = field(default_factory=dict)
    squared_weights: dict[str, Weight] = field(default_factory=dict)
    products: dict[str, Array] = field(default_factory=dict)
    records: dict[str, Record] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.squares:  # the measurement of one pass
            self.squared_weights.setdefault(name, self.weights[name] ** 2)

    def scale(self, factor: float) -> None:
        """Multiply the weight of the passes by ``factor``; their mean and its error do not change."""
        self._widen()
        for name, values in self.sums.items():
            values *= factor
            self.weights[name] = self.weights[name] * factor
        for table in (self.squares, self.products):
            for values in table.values():
                values *= factor**2
        for name in self.squared_weights:
            self.squared_weights[name] = self.squared_weights[name] * factor**2

    def assign(self, replica: int) -> None:
        """Make these passes, which are of replica 0, those of another replica."""
        self.iterations = Iterations({replica: self.iterations._intervals.get(0, [])})
        for name, record in self.records.items():
            parts = {(replica, iteration): record[zero, iteration] for zero, iteration in record.passes}
            self.records[name] = Record(parts)

    def mean(self, name: str = "image") -> Array:
        """``sums[name] / weights[name]``."""
        return np.divide(self.sums[name], self.weights[name], dtype=np.float64)

    def __iadd__(self, other: Measurement) -> Measurement:
        iterations = self.iterations.union(other.iterations)  # raises before anything changes
        if self._shapes() != other._shapes():
            raise EtendueError("measurements with different layers cannot be added; use the same settings for both")
        for name, record in other.records.items():
            self.records[name].check(record)
        self._widen()
        for name in other.squares:
            if {name} & (self.products.keys() | other.products.keys()) or not self._weighs_like(other, name):
                self.products[name] = self._product(name) + other._product(name)
            self.squared_weights[name] = self.squared_weights[name] + other.squared_weights[name]
        for name, value in other.sums.items():
            self.sums[name] += value
            self.weights[name] = self.weights[name] + other.weights[name]
        for name in other.squares:
            total = self.squares[name]
            if isinstance(other.squares, SquaresOf):
                other.squares.add_to(total, name)
            else:
                total += other.squares[name]
        for name, count in other.counters.items():
            self.counters[name] = self.counters.get(name, 0.0) + count
        for name, record in other.records.items():
            self.records[name] += record
        self.iterations = iterations
        return self

    def _widen(self) -> None:
        """Make the arrays of one pass, which may be another's, own ones that others can be added to."""
        if isinstance(self.squares, SquaresOf):
            self.sums = {name: np.array(values, np.float64, order="C") for name, values in self.sums.items()}
            self.squares = dict(self.squares)

    def _weighs_like(self, other: Measurement, name: str) -> bool:
        """Whether the passes of both have the same weight, given that those of each measurement have."""
        mine, theirs = (m.squared_weights[name] / m.weights[name] for m in (self, other))
        return bool(np.allclose(mine, theirs, rtol=1e-12, atol=0.0))

    def _product(self, name: str) -> Array:
        """Sum over passes of weight times sum."""
        if name in self.products:
            return self.products[name]
        factor = self.squared_weights[name] / self.weights[name]
        return np.multiply(self.sums[name], factor, dtype=np.float64)

    def _shapes(self) -> tuple[dict[str, tuple[int, ...]], dict[str, tuple[int, ...]], set[str]]:
        shapes = {name: values.shape for name, values in self.sums.items()}
        return shapes, {name: shapes[name] for name in self.squares}, set(self.records)

    def __add__(self, other: Measurement) -> Measurement:
        result = self.copy()
        result += other
        return result

    def copy(self) -> Measurement:
        """A copy, in double precision, of everything but the rows of records, which are never modified."""
        return Measurement(
            sums={k: v.astype(np.float64) for k, v in self.sums.items()},
            weights=dict(self.weights),
            iterations=Iterations(self.iterations._intervals),
            squares={k: v.astype(np.float64) for k, v in self.squares.items()},
            counters=dict(self.counters),
            squared_weights=dict(self.squared_weights),
            products={k: v.astype(np.float64) for k, v in self.products.items()},
            records={k: v.copy() for k, v in self.records.items()},
        )

    def has_error(self, name: str = "image") -> bool:
        """Whether the variance of ``mean(name)`` is estimated."""
        return name in self.squares or name + CONTRAST in self.sums

    def variance_of_mean(self, name: str = "image") -> Array:
        r"""Estimated variance of ``mean(name)``, from its contrast where there is one, else from the variance between
        passes; NaN with fewer than two passes.

        The mean of two independent halves has the variance of half their difference, of which the square of the
        contrast's mean is an unbiased estimate.

        Let passes i have weights :math:`w_i` and independent values :math:`x_i`, whose variances may differ. The
        variance of their weighted mean m is

        .. math:: \mathrm{Var}\, m = \frac{\sum w_i^2\, \mathrm{Var}\, x_i}{(\sum w_i)^2}
           \approx \frac{\sum w_i^2 (x_i - m)^2}{(\sum w_i)^2 - \sum w_i^2}

        The estimate is unbiased if the weights are equal, or the inverse of the variances.
        """
        mean, weight, squared_weight = self.mean(name), self.weights[name], self.squared_weights.get(name, np.nan)
        if len(self.iterations) < 2:
            return np.full_like(mean, np.nan)
        if name + CONTRAST in self.sums:
            return np.square(self.mean(name + CONTRAST))
        product = self.products[name] if name in self.products else squared_weight * mean
        scatter = self.squares[name] - mean * (2.0 * product - squared_weight * mean)
        return np.maximum(scatter, 0.0) / (weight * weight - squared_weight)

    def relative_error(self, name: str = "image") -> float:
        """Noise of ``mean(name)``: mean of ``variance / (mean^2 + 0.01)`` over all entries. Does not include bias.

        This is relMSE (``film.relative_mse``) with the estimated variance as the squared difference and the picture as
        the reference; it is too low if few bright paths determine pixels. NaN with fewer than two passes.
        """
        mean = self.mean(name)
        return float(np.mean(self.variance_of_mean(name) / (mean * mean + RELATIVE_EPSILON)))


def warn_of_nonfinite(measurement: Measurement) -> None:
    """Log the number of contributions that were left out of the picture because they were NaN or infinite."""
    count = measurement.counters.get("nonfinite", 0.0)
    if count > 0:
        logger.warning(
            "%d contributions were not finite (NaN or infinite) and were left out of the picture; "
            "look for extreme values in the scene's materials and lights",
            int(count),
        )
