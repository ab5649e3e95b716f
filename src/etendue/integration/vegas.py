"""An integrator derived from VEGAS: it learns a density that is a product over groups of parameters.

Estimator of an iteration: ``1/N sum f(x_i) / p(x_i)``, x_i drawn from ``p = prod_g p_g``; iterations are combined by
their inverse variances. After each iteration the borders of every factor are moved towards equal bin values.
[Lepage 1978; Leeson 2001, sec. 5.5]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from etendue.core import Array, logger

from .densities import AxisBins, CellGrid, Factor, PlaneBins, ProductDensity, bin_values
from .errors import IntegrationError
from .estimate import Estimate, Integrator, Moments, Work, average, combine
from .stratified import stratified_points

#: Largest number of bins per axis for factors of one and of two parameters, and samples per bin in an iteration.
_MOST = (1000, 64)
_PER_BIN = (10, 16)


class Vegas(Integrator):
    """Adaptive importance or stratified sampling with a learned density.

    Parameters
    ----------
    groups: parameters that share a factor of the density, ``[[0], [1, 2], [3, 4, 5]]``; parameters in no group are
        uniform. Groups of one and two have bins with movable borders, larger ones a grid of cells. By default each
        parameter is a group.
    mode: ``"importance"`` moves borders until all bins contribute equally; ``"stratified"`` moves them until all bins
        have the same deviation, and puts equal numbers of samples in each.
    iterations: how often the density is rebuilt; all iterations have equal numbers of samples.
    warm_up: number of first iterations that only train the density and are left out of the estimate.
    bins: on each axis of a factor; by default from the number of samples.
    strata: strata per axis of the adaptive parameters, in the uniform numbers that the density warps; 1 selects bins at
        random, ``None`` takes as many strata as allow two samples in each.
    smoothing: whether neighbouring bins are mixed by linear interpolation.
    damping: exponent of ``((1-d)/ln(1/d))^alpha``, which replaces the shares d of bins; ``None`` for none.
    inertia: r of ``(1-r) old + r new`` for cells of grids.
    stabilise: number of iterations after which smoothing, damping and inertia are switched off; they help with few
        samples, but slow down convergence with many. From then on borders adapt to contributions, not to their squares.
    density: the initial density, such as ``details["density"]`` of an earlier estimate.

    ``details``: ``iterations`` (an :class:`Estimate` each), ``density`` (:class:`ProductDensity`, the last),
    ``chi2`` over ``degrees`` of freedom among the iterations that count. Few samples in an iteration bias the
    combination slightly. If chi2 shows that iterations disagree, their variances are unreliable: they are then averaged
    with equal weights, with a warning.
    """

    def __init__(
        self,
        groups: Sequence[Sequence[int]] | None = None,
        mode: Literal["importance", "stratified"] = "importance",
        iterations: int = 10,
        warm_up: int = 0,
        bins: int | None = None,
        strata: int | None = None,
        smoothing: bool = True,
        damping: float | None = 0.75,
        inertia: float = 0.5,
        stabilise: int | None = None,
        density: ProductDensity | None = None,
    ) -> None:
        if mode not in ("importance", "stratified"):
            raise IntegrationError(f"mode is 'importance' or 'stratified', not {mode!r}")
        if iterations < 1 or not 0 <= warm_up < iterations:
            raise IntegrationError(f"{iterations} iterations with {warm_up} to warm up: at least one must count")
        if not 0 < inertia <= 1 or (damping is not None and damping < 0):
            raise IntegrationError(f"inertia {inertia} must be above 0 and at most 1, damping {damping} not negative")
        if any(v is not None and v < 1 for v in (bins, strata)):
            raise IntegrationError(f"bins ({bins}) and strata ({strata}) of an axis must be at least 1")
        self.groups, self.mode, self.iterations, self.warm_up = groups, mode, iterations, warm_up
        self.bins, self.strata, self.smoothing, self.damping = bins, strata, smoothing, damping
        self.inertia, self.stabilise, self.density = inertia, stabilise, density

    def _integrate(self, work: Work, samples: int) -> Estimate:
        share = samples // self.iterations
        if share < 2:
            raise IntegrationError(
                f"{samples} samples are too few for {self.iterations} iterations: each needs 2 or more"
            )
        density = self.density if self.density is not None else self._start(work, share)
        if density.domain != work.box:
            raise IntegrationError(f"the density is on {density.domain}, the function on {work.box}")
        strata, size = self._strata(density, share, work)
        done = []
        for number in range(self.iterations):
            steady = self.stabilise is not None and number >= self.stabilise
            estimate, values = self._iterate(work, density, strata, size, share, steady)
            done.append(estimate)
            smoothing, damping, inertia = (False, None, 1.0) if steady else (self.smoothing, self.damping, self.inertia)
            factors = [f.adapted(v, smoothing, damping, inertia) for f, v in zip(density.factors, values, strict=True)]
            density = ProductDensity(density.domain, density.groups, factors)
        counted = done[self.warm_up :]
        result = combine(counted)
        chi2, degrees = result.details["chi2"], result.details["degrees"]
        if chi2 > degrees + 5 * math.sqrt(2 * degrees):
            logger.warning(
                "iterations disagree (chi2 %.1f for %d degrees of freedom): some have missed a part of the function; "
                "all get equal weights; take more samples or some iterations to warm up",
                chi2,
                degrees,
            )
            result = replace(average(counted), details=result.details)
        details = result.details | {"iterations": done, "density": density}
        return replace(result, samples=sum(e.samples for e in done), details=details)

    def _start(self, work: Work, share: int) -> ProductDensity:
        """The uniform density with the bins that ``share`` samples an iteration can fill."""
        groups = self.groups if self.groups is not None else [[a] for a in range(work.dimension)]
        factors: list[Factor] = []
        adaptive = sum(len(group) for group in groups)
        for group in groups:
            n = len(group)
            if n == 0:
                raise IntegrationError("a group of parameters is empty")
            most = int((share / 2 + 1e-9) ** (1 / n))  # two samples for each of its bins
            if self.bins is not None:
                bins = self.bins
            elif self.mode == "stratified":
                bins = int((share / 2 + 1e-9) ** (1 / adaptive))
            elif n < 3:
                bins = min(int((share / _PER_BIN[n - 1]) ** (1 / n)), _MOST[n - 1])
            else:
                bins = int((share / 8) ** (1 / n))
            if n > 2 and self.bins is None:
                bins = min(bins, int((work.backend.cells + 0.5) ** (1 / n)))
            bins = max(bins, 1)
            if self.bins is not None and bins > max(most, 1):
                raise IntegrationError(
                    f"{share} samples an iteration are too few for {bins} bins an axis in {n} dimensions: "
                    f"at least {2 * bins**n}"
                )
            factors.append(
                AxisBins.even(bins) if n == 1 else PlaneBins.even(bins) if n == 2 else CellGrid.even(bins, n)
            )
        return ProductDensity(work.box, groups, factors)

    def _strata(self, density: ProductDensity, share: int, work: Work) -> tuple[list[int], int]:
        """Parts of each axis of the unit cube, and samples in each stratum."""
        strata = [1] * density.domain.dimension
        adaptive = sum(len(group) for group in density.groups)
        if adaptive:
            most = int((share / 2 + 1e-9) ** (1 / adaptive))
            wanted = self.strata
            if wanted is None and self.mode == "stratified" and self.bins is not None:
                wanted = self.bins
            largest = max(len(group) for group in density.groups)
            fine = work.backend.parts if largest < 3 else int((work.backend.cells + 0.5) ** (1 / largest))
            parts = min(max(most, 1), fine) if wanted is None else wanted
            if parts > fine:
                raise IntegrationError(f"{parts} strata of an axis are too many for single precision: at most {fine}")
            if parts > max(most, 1):
                raise IntegrationError(
                    f"{share} samples an iteration are too few to stratify {adaptive} dimensions into {parts} parts "
                    f"each: at least {2 * parts**adaptive}"
                )
            for group in density.groups:
                # The first number of a grid selects its cell, so it takes the strata of all its axes.
                for position, axis in enumerate(group):
                    strata[axis] = parts if len(group) < 3 else parts ** len(group) if position == 0 else 1
            if wanted is None and self.mode == "importance" and parts > 1:
                # One more stratum on as many axes as there are samples for.
                for axis in (a for group in density.groups if len(group) < 3 for a in group):
                    if 2 * math.prod(strata) // parts * (parts + 1) <= share:
                        strata[axis] += 1
        return strata, share // math.prod(strata)

    def _iterate(
        self, work: Work, density: ProductDensity, strata: list[int], size: int, samples: int, steady: bool
    ) -> tuple[Estimate, list[Array]]:
        """An estimate with ``density``, and the value of each bin of each factor, as of :func:`bin_values`."""
        volume = work.box.volume
        total = math.prod(strata)
        sums = [np.zeros((3 if self.mode == "stratified" else 1, f.bins)) for f in density.factors]
        if total == 1:
            size = samples
            moments = Moments()
            for count in work.batches(samples):
                values, found = self._draw(work, density, strata, count, 0, 1)
                moments.add(count, *work.backend.moments(values))
                self._deposit(work, sums, found)
            value, error = moments.mean, moments.standard_error
        else:
            mean = variance = 0.0
            first = 0
            for count in work.batches(total * size, size):
                values, found = self._draw(work, density, strata, count, first, size)
                a, b = work.backend.strata(values, size)
                mean, variance, first = mean + a, variance + b, first + count // size
                self._deposit(work, sums, found)
            value, error = mean / total, math.sqrt(variance) / total
        used = total * size
        return Estimate(value * volume, error * volume, used), [
            bin_values(f, s, used, self.mode, steady) for f, s in zip(density.factors, sums, strict=True)
        ]

    def _draw(
        self, work: Work, density: ProductDensity, strata: list[int], count: int, first: int, size: int
    ) -> tuple[Any, list[list[Any]]]:
        """``count`` values f / p in strata from index ``first`` on, and what to add to the bins of each factor."""
        backend = work.backend
        u = stratified_points(work, count, strata, first, size)
        x, weight, places = density.warp(backend, u)
        values = work.values(x, weight)
        weights = [values * values]
        if self.mode == "stratified":
            weights += [values, backend.broadcast(1.0, x)]
        found = [backend.histogram(p, weights, f.bins) for p, f in zip(places, density.factors, strict=True)]
        return values, found

    @staticmethod
    def _deposit(work: Work, sums: list[Array], found: list[list[Any]]) -> None:
        """Add the bin sums of a batch. Called after the values are evaluated, so that one kernel computes both."""
        for total, parts in zip(sums, found, strict=True):
            for row, part in zip(total, parts, strict=True):
                row += work.backend.host(part)
