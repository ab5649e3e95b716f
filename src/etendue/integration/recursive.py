"""Recursive stratified sampling: MISER with seven changes [Press 1990; Leeson 2001, sec. 5.6].

A region is explored with some of its samples and divided along one dimension; each part gets samples according to the
variation of the function in it. All regions of a level are processed at once, so that the integrand is evaluated in a
few large batches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .densities.binning import split_equally
from .errors import IntegrationError
from .estimate import Estimate, Integrator, Work
from .functions import Integrand
from .regions import Regions

#: Real or whole numbers of the host.
Array = NDArray[Any]
Metric = Literal["range", "maximum", "variance"]
#: Smallest number of exploration bins from which ``"vegas"`` borders are found.
_BINS = 8
_METRICS = ("range", "maximum", "variance")


@dataclass
class _Level:
    """Regions of one depth. ``low``, ``side``: (R, d) in the unit cube; ``samples``: (R,); ``parent``: (R,) index in
    the level above; ``explored``: (R, 3) value, variance and count of the exploration, NaN without exploration;
    ``value``, ``variance``: (R,) of the integral."""

    low: Array
    side: Array
    samples: Array
    parent: Array
    explored: Array
    value: Array
    variance: Array

    @classmethod
    def of(cls, low: Array, side: Array, samples: Array, parent: Array) -> _Level:
        count = len(samples)
        return cls(low, side, samples, parent, np.full((count, 3), np.nan), np.zeros(count), np.zeros(count))

    @property
    def volume(self) -> Array:
        volume: Array = self.side.prod(axis=1)
        return volume


class RecursiveStratified(Integrator):
    """Recursive stratification: the domain is divided where the integrand varies.

    Parameters
    ----------
    metric: the measure of variation within a bin: ``"range"`` (max - min)^2, ``"maximum"`` max^2 of the absolute
        values, ``"variance"`` mean square minus squared mean. The first two grow with the count, but compare bins of
        equal counts; the third is poor at low counts.
    divisions: parts of a division, n.
    weights: of the dimensions; a dimension with a larger weight is divided more often, with zero never.
    initial_depth: levels that are divided without exploration, along dimensions in turn by their weights.
    dither: borders of equal parts are moved randomly by up to half this share of a part, to either side.
    borders: ``"equal"`` divides into equal parts, ``"vegas"`` into parts that share the metric equally.
    exploration: share of a region's samples that explores it.
    reuse: whether the estimate includes the exploration, by inverse variances; this helps with few samples, but is
        biased.
    exponent: a in N_i ~ Var_i^(1/(1+a)), Var_i the metric times the squared volume; 1 suits one level, 2 recursion.
    minimum: regions with fewer samples are not divided; by default 4 n d.
    depth: largest number of levels.

    If the integrand has a ``cost``, the samples of a part are also divided by the root of its mean cost. ``details``:
    ``regions``, ``depth``, and, for an integrand with a cost, ``cost``, the sum over all evaluations.
    """

    def __init__(
        self,
        metric: Metric = "variance",
        divisions: int = 2,
        weights: Sequence[float] | None = None,
        initial_depth: int = 0,
        dither: float = 0.0,
        borders: Literal["equal", "vegas"] = "equal",
        exploration: float = 0.1,
        reuse: bool = False,
        exponent: float = 2.0,
        minimum: int | None = None,
        depth: int = 40,
    ) -> None:
        if metric not in _METRICS:
            raise IntegrationError(f"the metric is one of {', '.join(_METRICS)}, not {metric!r}")
        if borders not in ("equal", "vegas"):
            raise IntegrationError(f"borders are 'equal' or 'vegas', not {borders!r}")
        if divisions < 2 or not 0 < exploration < 1 or not 0 <= dither < 1 or exponent <= 0 or initial_depth < 0:
            raise IntegrationError(
                f"divisions {divisions} must be 2 or more, exploration {exploration} within (0, 1), dither {dither} "
                f"within [0, 1), exponent {exponent} positive, initial_depth {initial_depth} not negative"
            )
        if dither and borders == "vegas":
            raise IntegrationError("dither moves the borders of equal parts only: leave it at 0 with borders='vegas'")
        if weights is not None and (min(weights, default=-1) < 0 or not 0 < sum(weights) < math.inf):
            raise IntegrationError(f"weights of dimensions must not be negative, nor all zero, but are {list(weights)}")
        self.metric, self.divisions, self.weights, self.initial_depth = metric, divisions, weights, initial_depth
        self.dither, self.borders, self.exploration, self.reuse = dither, borders, exploration, reuse
        self.exponent, self.minimum, self.depth = exponent, minimum, depth

    def gains(self, metrics: Array, after: Array, means: Callable[[], Array]) -> Array:
        """The gain of a division along each dimension, (d, regions) above zero: the share of the variation that it
        removes. The dimension with the largest product of weight and gain is divided.

        ``metrics``, and ``means`` if it is called: the metric and the mean of the function in each part, (d, regions,
        parts). ``after``: the variation that remains, (d, regions).
        """
        whole = np.maximum(metrics.mean(axis=2).max(axis=0), np.finfo(float).tiny)
        gains: Array = np.maximum(1.0 - after / whole, 1e-12)
        return gains

    def _integrate(self, work: Work, samples: int) -> Estimate:
        run = _Run(self, work)
        levels = run.descend(samples)
        run.collect(levels)
        details: dict[str, Any] = {"regions": run.leaves, "depth": len(levels) - 1}
        if work.f.cost is not None:
            details["cost"] = run.cost
        volume = work.box.volume
        value, variance = float(levels[0].value[0]), float(levels[0].variance[0])
        return Estimate(value * volume, math.sqrt(variance) * volume, run.used, details=details)

    def plan(self, f: Integrand, samples: int, seed: int = 0) -> Regions:
        """Where ``samples`` of ``f`` would be drawn, found by exploration only: the final regions, each with its share
        of the samples. The domain is mapped to the unit cube."""
        run = _Plan(self, Work(f, seed))
        run.descend(samples)
        return Regions(*(np.concatenate(parts) for parts in zip(*run.regions, strict=True)))


class _Run:
    """The state of one integration, shared by its levels."""

    def __init__(self, options: RecursiveStratified, work: Work) -> None:
        d = work.dimension
        self.o, self.work, self.d = options, work, d
        weights = np.ones(d) if options.weights is None else np.asarray(options.weights, dtype=float)
        if len(weights) != d:
            raise IntegrationError(f"{len(weights)} weights for {d} dimensions: one is needed for each")
        self.weights = weights
        self.minimum = 4 * options.divisions * d if options.minimum is None else options.minimum
        self.order = self._blind_order()
        self.used = self.leaves = 0
        self.cost = 0.0

    def _blind_order(self) -> list[int]:
        """The dimension of each level without exploration: the one with the largest deficit relative to its weight."""
        times, order = np.zeros(self.d), []
        for _ in range(self.o.initial_depth):
            axis = int(np.argmax(self.weights / (times + 1)))
            times[axis] += 1
            order.append(axis)
        return order

    def evaluate(
        self, level: _Level, regions: Array, counts: Array, keep: bool = False
    ) -> tuple[Array, Array, Array | None]:
        """Per region: uniform points (d, n) of its unit cube, if ``keep``; values there; and costs."""
        work, backend = self.work, self.work.backend
        place = np.repeat(regions, counts)
        xs, values, costs = [], [], []
        first = 0
        for count in work.batches(len(place)):
            part = place[first : first + count]
            first += count
            u = backend.uniform(count, self.d)
            index = backend.table(part) if work.f.on == "device" else part
            low = [backend.take(backend.table(level.low[:, a]), index) for a in range(self.d)]
            side = [backend.take(backend.table(level.side[:, a]), index) for a in range(self.d)]
            x = work.box.from_unit([a + b * c for a, b, c in zip(low, side, u, strict=True)])
            values.append(backend.host(work.values_at(x)))
            if keep:
                xs.append(np.stack([backend.host(v) for v in u]))
            if work.f.cost is not None:
                costs.append(backend.host(backend.broadcast(work.f.cost(x), x)))
        self.used += len(place)
        if not values:
            return np.empty((self.d, 0)), np.empty(0), None
        cost = np.concatenate(costs) if costs else None
        if cost is not None:
            self.cost += float(cost.sum())
        points = np.concatenate(xs, axis=1) if xs else np.empty((self.d, 0))
        return points, np.concatenate(values), cost

    def descend(self, samples: int) -> list[_Level]:
        """Divide the domain completely; returns all levels."""
        corner, side = np.zeros((1, self.d)), np.ones((1, self.d))
        level = _Level.of(corner, side, np.array([samples]), np.array([-1]))
        levels = [level]
        while len(level.samples) and len(levels) <= self.o.depth + 1:
            level = self.divide(level, len(levels) - 1)
            if len(level.samples):
                levels.append(level)
        return levels

    def divide(self, level: _Level, depth: int) -> _Level:
        """Finish the leaves of a level, explore and divide the other regions; returns their parts."""
        n, o = self.o.divisions, self.o
        blind = depth < o.initial_depth
        # A division without exploration needs two samples in each part, a division with exploration needs more.
        enough = 2 * n if blind else max(self.minimum, 4 * n)
        inner = (level.samples >= enough) & (depth < o.depth)
        if blind and not inner.all():
            raise IntegrationError(
                f"samples are too few for {o.initial_depth} initial levels of {n} parts: "
                f"at least {2 * n**o.initial_depth}"
            )
        self._finish(level, np.flatnonzero(~inner))
        regions = np.flatnonzero(inner)
        count = len(regions)
        if not count:
            return _Level.of(np.empty((0, self.d)), np.empty((0, self.d)), np.empty(0, int), np.empty(0, int))
        rest = level.samples[regions]
        if blind:
            axis = np.full(count, self.order[depth])
            borders = self._equal_borders(count, n, o.dither)
            parts = np.ones((count, n))
        else:
            # At least two samples of each part explore it, and two remain for its estimate.
            spent = np.clip((o.exploration * rest).astype(int), 2 * n, rest - 2 * n)
            axis, borders, parts = self._explore(level, regions, spent)
            rest = rest - spent
        share = self._allocate(rest, parts * np.diff(borders) if blind else parts)
        low, side = np.repeat(level.low[regions], n, axis=0), np.repeat(level.side[regions], n, axis=0)
        row, column = np.arange(count * n), np.repeat(axis, n)
        width = side[row, column]
        low[row, column] += width * borders[:, :-1].ravel()
        side[row, column] = width * np.diff(borders).ravel()
        return _Level.of(low, side, share.ravel(), np.repeat(regions, n))

    def _finish(self, level: _Level, leaves: Array) -> None:
        """Plain Monte Carlo in each leaf."""
        counts = level.samples[leaves]
        self.leaves += len(leaves)
        _, values, _ = self.evaluate(level, leaves, counts)
        if not len(values):
            return
        place = np.repeat(np.arange(len(leaves)), counts)
        mean = np.bincount(place, values, len(leaves)) / counts
        squares = np.bincount(place, (values - mean[place]) ** 2, len(leaves))
        volume = level.volume[leaves]
        level.value[leaves] = mean * volume
        level.variance[leaves] = squares / (counts - 1) / counts * volume**2

    def _equal_borders(self, count: int, parts: int, dither: float) -> Array:
        borders = np.tile(np.linspace(0.0, 1.0, parts + 1), (count, 1))
        if dither:
            random = np.asarray(self.work.backend.host(self.work.backend.uniform(count * (parts - 1), 1)[0]))
            # By half the dither to either side, so that the distance of borders is at least 1 - dither parts.
            borders[:, 1:-1] += (random.reshape(count, parts - 1) - 0.5) * dither / parts
        return borders

    def _explore(self, level: _Level, regions: Array, spent: Array) -> tuple[Array, Array, Array]:
        """For each region the dimension to divide, the borders (R, n+1), and relative numbers of samples of the parts
        (R, n)."""
        o, count = self.o, len(regions)
        x, values, cost = self.evaluate(level, regions, spent, keep=True)
        place = np.repeat(np.arange(count), spent)
        mean = np.bincount(place, values, count) / spent
        total = np.bincount(place, (values - mean[place]) ** 2, count)
        volume = level.volume[regions]
        level.explored[regions] = np.stack([mean * volume, total / (spent - 1) / spent * volume**2, spent], axis=1)

        n = o.divisions if o.borders == "equal" else max(_BINS, o.divisions)
        edges = self._equal_borders(count, n, o.dither)
        inner = edges[:, 1:-1][place].T
        width = np.diff(edges)
        power = 1 / (1 + o.exponent)
        bins = np.empty((self.d, len(values)), int)
        metrics, after = np.empty((self.d, count, n)), np.empty((self.d, count))
        for a in range(self.d):
            bins[a] = place * n + (x[a] >= inner).sum(axis=0)
            metrics[a] = self._metric(bins[a], values, count * n).reshape(count, n)
            # The variation that remains after the division, with the samples distributed over the parts.
            after[a] = ((width**2 * metrics[a]) ** power).sum(axis=1) ** (1 + o.exponent)
            after[a] /= (width ** (2 * power)).sum(axis=1) ** (1 + o.exponent)

        def means() -> Array:
            sums = [
                np.bincount(b, values, count * n) / np.maximum(np.bincount(b, minlength=count * n), 1) for b in bins
            ]
            return np.reshape(sums, (self.d, count, n))

        axis = np.argmax(self.weights[:, None] * o.gains(metrics, after, means), axis=0)
        metric = metrics[axis, np.arange(count)]
        dear = np.ones((count, n))
        if cost is not None:
            chosen = bins[axis[place], np.arange(len(values))]
            number = np.bincount(chosen, minlength=count * n)
            seen = np.bincount(chosen, cost, count * n) / np.maximum(number, 1)
            dear = np.where(number > 0, seen, cost.mean()).reshape(count, n)
        if o.borders == "vegas":
            edges, width, metric, dear = self._rebinned(edges, metric, dear)
        return axis, edges, (width**2 * metric) ** power / np.sqrt(dear)

    def _rebinned(self, edges: Array, metric: Array, dear: Array) -> tuple[Array, Array, Array, Array]:
        """Borders of parts that hold equal shares of deviation times width, as bins of VEGAS would; the parts' widths,
        and the metric and the cost in them."""
        width = np.diff(edges)
        held = np.sqrt(metric) * width
        held = 0.8 * held + 0.2 * held.mean(axis=1, keepdims=True)  # so that no part becomes too thin
        borders = np.stack([split_equally(e, h, self.o.divisions) for e, h in zip(edges, held, strict=True)])
        parts = np.diff(borders)

        def mean(values: Array) -> Array:
            reached = np.concatenate([np.zeros((len(values), 1)), np.cumsum(values * width, axis=1)], axis=1)
            at = np.stack([np.interp(b, e, r) for b, e, r in zip(borders, edges, reached, strict=True)])
            return np.asarray(np.diff(at) / parts)

        return borders, parts, mean(metric), mean(dear)

    def _metric(self, bins: Array, values: Array, size: int) -> Array:
        """The variation in each bin, as a variance."""
        if self.o.metric == "variance":
            number = np.maximum(np.bincount(bins, minlength=size), 1)
            mean = np.bincount(bins, values, size) / number
            return np.asarray(np.bincount(bins, (values - mean[bins]) ** 2, size) / number)
        largest = np.full(size, -np.inf)
        if self.o.metric == "maximum":
            np.maximum.at(largest, bins, np.abs(values))
            return np.where(np.isfinite(largest), largest, 0.0) ** 2
        least = np.full(size, np.inf)
        np.maximum.at(largest, bins, values)
        np.minimum.at(least, bins, values)
        return np.where(np.isfinite(largest), largest - least, 0.0) ** 2

    def _allocate(self, rest: Array, parts: Array) -> Array:
        """Whole numbers of samples (R, n), 2 or more each, that add up to ``rest`` in the ratio of ``parts``."""
        n = self.o.divisions
        total = parts.sum(axis=1, keepdims=True)
        ratio = np.where(total > 0, parts / np.where(total > 0, total, 1.0), 1 / n)
        # Parts without measured variation get a tenth of an equal share, since the exploration may have missed a part
        # of the function.
        ratio = 0.9 * ratio + 0.1 / n
        free = rest - 2 * n
        share = (ratio * free[:, None]).astype(int)
        share[np.arange(len(rest)), np.argmax(ratio, axis=1)] += free - share.sum(axis=1)
        return np.asarray(share + 2)

    def collect(self, levels: list[_Level]) -> None:
        """Add the parts of each region, from the deepest level up, and its exploration if explorations are reused."""
        for above, level in zip(levels[-2::-1], levels[:0:-1], strict=True):
            size = len(above.samples)
            value = np.bincount(level.parent, level.value, size)
            variance = np.bincount(level.parent, level.variance, size)
            inner = np.zeros(size, bool)
            inner[level.parent] = True
            if self.o.reuse:
                value, variance = self._with_exploration(above, inner, value, variance)
            above.value[inner], above.variance[inner] = value[inner], variance[inner]

    @staticmethod
    def _with_exploration(above: _Level, inner: Array, value: Array, variance: Array) -> tuple[Array, Array]:
        """Inverse-variance means of the parts' sums and the exploration."""
        seen, seen_variance, count = above.explored.T
        use = inner & np.isfinite(seen)
        rest = np.maximum(above.samples - count, 1)
        # A few uniform samples cannot be more accurate than many stratified ones; if they seem so, they missed a part
        # of the function.
        bound = np.maximum(seen_variance, variance * rest / np.maximum(count, 1))
        weight = np.where(use & (bound > 0), variance / np.where(bound + variance > 0, bound + variance, 1.0), 0.0)
        weight = np.where(use, weight, 0.0)
        combined = np.where(use, (1 - weight) * value + weight * np.where(use, seen, 0.0), value)
        return combined, np.where(use, (1 - weight) * variance, variance)


class _Plan(_Run):
    """A run that does not evaluate its leaves."""

    def __init__(self, options: RecursiveStratified, work: Work) -> None:
        super().__init__(options, work)
        self.regions: list[tuple[Array, Array, Array]] = []

    def _finish(self, level: _Level, leaves: Array) -> None:
        self.regions.append((level.low[leaves], level.side[leaves], level.samples[leaves]))
