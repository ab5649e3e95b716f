"""Integrators with evenly distributed points: strata, and point sequences."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from etendue.points import Sobol

from .backend import Numbers, Whole
from .errors import IntegrationError
from .estimate import Estimate, Integrator, Moments, Work


class Stratified(Integrator):
    """``V / S^d`` times the sum of the means of f in S^d equal strata, S per axis, with equal numbers of samples.

    ``strata`` is S; by default as many as allow two samples in each. Raises :class:`IntegrationError` for fewer than
    2^(d+1) samples (two strata per axis, two samples in each), or too few for the given ``strata``.
    """

    batched = True

    def __init__(self, strata: int | None = None) -> None:
        if strata is not None and strata < 1:
            raise IntegrationError(f"an axis has at least one stratum, not {strata}")
        self.strata = strata

    def _integrate(self, work: Work, samples: int) -> Estimate:
        d = work.dimension
        parts = self._parts(work, samples / 2, 2)
        if samples < 2 * parts**d:
            raise IntegrationError(
                f"{samples} samples are too few to stratify {d} dimensions into {parts} parts each: "
                f"at least {2 * parts**d}"
            )
        total = parts**d
        size = samples // total
        mean = variance = 0.0
        first = 0
        for count in work.batches(total * size, size):
            u = stratified_points(work, count, [parts] * d, first, size)
            a, b = work.backend.strata(work.values(u), size)
            mean, variance, first = mean + a, variance + b, first + count // size
        scale = work.box.volume / total
        return Estimate(mean * scale, math.sqrt(variance) * scale, total * size, details={"strata": parts})

    def spread(self, work: Work, integrals: int, samples: int) -> tuple[Any, Any, int]:
        """See :class:`Integrator`. There is no error estimate, so one sample per stratum is enough."""
        d = work.dimension
        parts = self._parts(work, samples, 1)
        if samples < parts**d:
            raise IntegrationError(f"{samples} samples are too few for {parts**d} strata: at least one each")
        size = samples // parts**d * parts**d
        u = stratified_points(work, integrals * size, [parts] * d, 0, size // parts**d)
        return work.box.from_unit(u), work.box.volume, size

    def _parts(self, work: Work, strata: float, least: int) -> int:
        """Strata of an axis: by default as many as give ``strata`` in all, and at least ``least``."""
        most = work.backend.parts
        if self.strata is None:
            return min(max(int((strata + 1e-9) ** (1 / work.dimension)), least), most)
        if self.strata > most:
            raise IntegrationError(f"{self.strata} strata of an axis are too many for single precision: at most {most}")
        return self.strata


def stratified_points(work: Work, count: int, parts: list[int], first: int, size: int) -> list[Numbers]:
    """``count`` points of the unit cube, ``size`` at random in each stratum, from stratum ``first`` on. Axis i is
    divided into ``parts[i]`` strata; the first axis changes fastest."""
    backend = work.backend
    u = list(backend.uniform(count, work.dimension))
    left = None
    for axis, n in enumerate(parts):
        if n == 1:
            continue
        if left is None:
            left = backend.index(count) // size + backend.opaque(first)
        rest = left // n
        u[axis] = (u[axis] + backend.number(left - rest * n)) * (1.0 / n)
        left = rest
    return u


class PointSequence(Protocol):
    """The interface of points: of the point sets of ``etendue.points``, and of others with these methods."""

    dimension: int

    def coordinate(self, index: Whole, dimension: int) -> Numbers:
        """Coordinate ``dimension`` of the points ``index``: whole numbers of NumPy, or ``UInt32`` of the device."""
        ...

    def randomised(self, seed: int) -> PointSequence:
        """The points randomised so that each is uniform; different seeds are independent."""
        ...


class QuasiMonteCarlo(Integrator):
    """``V/N sum f(x_i)`` over the points of a low-discrepancy sequence.

    It uses several independent randomisations: their mean is the estimate, their variance gives its error.

    Parameters
    ----------
    points: a point set, or a function from the number of dimensions to one; by default :class:`Sobol` with Owen's
        scrambling. It may have more dimensions than the integrand.
    replicates: randomisations that share the samples; fewer give a smaller error, more a better estimate of the error.
    """

    batched = True

    def __init__(self, points: PointSequence | Callable[[int], PointSequence] = Sobol, replicates: int = 16) -> None:
        if replicates < 2:
            raise IntegrationError(f"an error needs 2 randomisations or more, not {replicates}")
        self.points, self.replicates = points, replicates

    def _integrate(self, work: Work, samples: int) -> Estimate:
        sequence = self.sequence(work.dimension)
        share = samples // self.replicates
        size = getattr(sequence, "size", None)
        if share < 1:
            raise IntegrationError(f"{samples} samples are too few for {self.replicates} randomisations of a sequence")
        if size is not None and share > size:
            raise IntegrationError(f"the point set has {size} points, but each randomisation needs {share}")
        means = []
        for number in range(self.replicates):
            points = sequence.randomised(work.seed * self.replicates + number)
            moments, first = Moments(), 0
            for count in work.batches(share):
                values = work.values(self.block(work, points, first, count))
                moments.add(count, *work.backend.moments(values))
                first += count
            means.append(moments.mean)
        scale = work.box.volume
        error = float(np.std(means, ddof=1)) / math.sqrt(self.replicates)
        return Estimate(
            float(np.mean(means)) * scale,
            error * scale,
            share * self.replicates,
            details={"replicates": np.array(means) * scale},
        )

    def spread(self, work: Work, integrals: int, samples: int) -> tuple[Any, Any, int]:
        """See :class:`Integrator`. Each integral uses all points, with its own random shift modulo 1."""
        backend, sequence = work.backend, self.sequence(work.dimension)
        most = getattr(sequence, "size", None)
        if most is not None and samples > most:
            raise IntegrationError(f"the point set has {most} points, but each integral needs {samples}")
        place = backend.index(integrals * samples)
        number = place // samples
        u = []
        for axis, shift in enumerate(backend.uniform(integrals, work.dimension)):
            moved = sequence.coordinate(place - number * samples, axis) + backend.take(shift, number)
            u.append(backend.where(moved < 1.0, moved, moved - 1.0))
        return work.box.from_unit(u), work.box.volume, samples

    def sequence(self, dimension: int) -> PointSequence:
        """The points for an integrand of ``dimension`` parameters."""
        points: Any = self.points
        chosen: PointSequence = points(dimension) if isinstance(points, type) or callable(points) else points
        if chosen.dimension < dimension:
            raise IntegrationError(f"the point set has {chosen.dimension} dimensions, the integrand {dimension}")
        return chosen

    @staticmethod
    def block(work: Work, points: PointSequence, first: int, count: int) -> list[Numbers]:
        """``count`` points from index ``first`` on."""
        index = work.backend.index(count) + work.backend.opaque(first)
        return [points.coordinate(index, a) for a in range(work.dimension)]
