"""Densities of several parameters: products of factors over groups, and densities given by functions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from etendue.core import Array

from ..backend import Backend, HostBackend, Numbers, Points, Whole
from ..errors import IntegrationError
from ..functions import Box, Domain, Integrand
from .binning import rebin
from .factors import AxisBins, Factor, PlaneBins


class Density(Protocol):
    """A probability density on a box from which an integrator can sample."""

    domain: Box

    def sample(self, backend: Backend, u: Points) -> tuple[Points, Numbers]:
        """Points of the domain from points ``u`` of the unit cube, coordinate-major, and the density at each."""
        ...

    def pdf(self, backend: Backend, x: Points) -> Numbers:
        """The density at points of the domain."""
        ...


class ProductDensity:
    """``p(x) = prod_g p_g(x_g)`` over groups of parameters of a box; those in no group are uniform.

    Parameters
    ----------
    domain: the box.
    groups: the parameters of each factor.
    factors: one for each group.
    """

    def __init__(self, domain: Domain, groups: Sequence[Sequence[int]], factors: Sequence[Factor]) -> None:
        self.domain = Box.of(domain)
        self.groups = [tuple(group) for group in groups]
        self.factors = list(factors)
        used = list(itertools.chain.from_iterable(self.groups))
        if len(set(used)) != len(used) or any(not 0 <= a < self.domain.dimension for a in used):
            raise IntegrationError(
                f"groups {self.groups} of parameters: each may occur once, from 0 to {self.domain.dimension - 1}"
            )
        if [f.dimension for f in self.factors] != [len(g) for g in self.groups]:
            raise IntegrationError("each group of parameters needs a factor of as many dimensions")

    @classmethod
    def tabulated(cls, f: Integrand, bins: int = 64) -> ProductDensity:
        """The piecewise constant density of one or two parameters proportional to ``|f|`` at the centres of ``bins``
        bins per axis.

        Raises :class:`IntegrationError` if ``f`` cannot be normalised: not finite somewhere, or zero everywhere.
        """
        if f.dimension > 2 or f.on == "device":
            raise IntegrationError("a density is tabulated from a function of one or two parameters on the host")
        grid = (np.arange(bins) + 0.5) / bins
        points = np.stack([axis.ravel() for axis in np.meshgrid(*[grid] * f.dimension, indexing="ij")])
        values = np.abs(np.broadcast_to(f.evaluate(f.domain.from_unit(points)), points.shape[1:])).astype(float)
        if not np.isfinite(values).all() or not values.sum() > 0:
            raise IntegrationError(
                "a density cannot be made of a function that is not finite, or zero everywhere: not normalisable"
            )
        # A bin with f = 0 at its centre may have other values elsewhere, so it must be sampled, too.
        values = np.maximum(values, 1e-3 * values.mean())
        even = np.linspace(0.0, 1.0, bins + 1)
        if f.dimension == 1:
            factor: Factor = AxisBins(rebin(even, values))
        else:
            rows = values.reshape(bins, bins)
            start = PlaneBins.even(bins)
            factor = start.adapted(rows.ravel(), False, None, 1.0)
        return cls(f.domain, [tuple(range(f.dimension))], [factor])

    def warp(self, backend: Backend, u: Points) -> tuple[list[Numbers], Numbers, list[Whole]]:
        """Points of the unit cube, 1 / density there, and the bin in each factor."""
        x = list(u)
        weight: Numbers | float = 1.0
        places = []
        for group, factor in zip(self.groups, self.factors, strict=True):
            warped, inverse, place = factor.warp(backend, [u[a] for a in group])
            for axis, value in zip(group, warped, strict=True):
                x[axis] = value
            weight = weight * inverse
            places.append(place)
        return x, weight, places

    def sample(self, backend: Backend, u: Points) -> tuple[Points, Numbers]:
        """See :class:`Density`."""
        x, weight, _ = self.warp(backend, u)
        return self.domain.from_unit(x), 1.0 / (weight * self.domain.volume)

    def pdf(self, backend: Backend, x: Points) -> Numbers:
        """See :class:`Density`."""
        unit = self.domain.to_unit(x)
        p: Numbers | float = 1.0 / self.domain.volume
        for group, factor in zip(self.groups, self.factors, strict=True):
            p = p * factor.pdf(backend, [unit[a] for a in group])
        return backend.broadcast(p, x)

    def draw(self, count: int, seed: int = 0) -> tuple[Array, Array]:
        """``count`` points (d, count) on the host and the density at each."""
        backend = HostBackend(seed)
        x, p = self.sample(backend, backend.uniform(count, self.domain.dimension))
        return np.stack(list(x)), backend.broadcast(p, x)


class Warp:
    """A density given by two functions: ``sample``, from points of the unit cube to points of the domain, and ``pdf``.

    Both take and return coordinate-major arrays, as functions of an :class:`Integrand` do.
    """

    def __init__(self, domain: Domain, sample: Callable[[Points], Points], pdf: Callable[[Points], Numbers]) -> None:
        self.domain, self._sample, self._pdf = Box.of(domain), sample, pdf

    def sample(self, backend: Backend, u: Points) -> tuple[Points, Numbers]:
        """See :class:`Density`."""
        x = self._sample(u)
        return x, backend.broadcast(self._pdf(x), x)

    def pdf(self, backend: Backend, x: Points) -> Numbers:
        """See :class:`Density`."""
        return backend.broadcast(self._pdf(x), x)
