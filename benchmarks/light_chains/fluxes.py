"""Flux on cells of surfaces, from particles of any method, and its error."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from etendue.core import Array, Replica
from etendue.methods import MetropolisParticles, ParticleTracing
from etendue.particles import Particles
from etendue.scene import Problem

_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
#: Shapes with more primitives are one row of cells, a primitive each, and those with still more have no cells: the
#: furniture of an office, in triangles of a millimetre.
_MOST_DIVIDED, _MOST = 16, 5000


class Cells:
    """Cells of the shapes of a scene: ``side`` by ``side`` of each primitive of those with few, the primitives of
    others, unless they have too many."""

    def __init__(self, problem: Problem, side: int) -> None:
        counts = np.array([max(1, int(s.effective_primitive_count())) for s in problem.scene.shapes()])
        self._side = np.where(counts <= _MOST_DIVIDED, side, counts <= _MOST)
        each = counts * self._side**2
        self._first = np.cumsum(each) - each
        self.count = int(each.sum())

    def luminance(self, particles: Particles) -> Array:
        """Luminance of the flux on each cell."""
        side = self._side[particles.shape]
        particles, side = particles[side > 0], side[side > 0]
        u, v = (np.minimum((particles.uv[:, i] * side).astype(np.int64), side - 1) for i in (0, 1))
        cell = self._first[particles.shape] + (particles.primitive.astype(np.int64) * side + v) * side + u
        return np.bincount(cell, particles.power.astype(np.float64) @ _LUMINANCE, self.count)


class Tally:
    """A tracer that runs pass by pass, and the flux on cells that its particles have brought so far."""

    def __init__(self, kind: type[Any], problem: Problem, cells: Cells, seed: int, **settings: Any) -> None:
        self._method = kind(kind.Settings.from_mapping(settings))
        begin = time.process_time()
        self._method.prepare(problem, seed)
        self.cpu = time.process_time() - begin
        self._replica, self._cells, self._sums = Replica(self._method, seed), cells, np.zeros(cells.count)
        self.rays, self.particles, self._units, self._passes = 0.0, 0.0, 0.0, 0

    def run(self, passes: int) -> Array:
        """Trace until there are ``passes`` passes; returns the flux on the cells. Counting is not in ``cpu``."""
        while self._passes < passes:
            begin = time.process_time()
            measurement = self._replica.step(self._passes)
            self.cpu += time.process_time() - begin
            self._passes += 1
            counters = measurement.counters
            found = self._method.particles(measurement)
            self._sums += self._cells.luminance(found) * counters["paths"]
            self._units += counters["paths"]
            self.rays += counters["rays"]
            # A state that a chain repeats counts as often.
            self.particles += counters["paths"] if isinstance(self._method, MetropolisParticles) else len(found)
        return self._sums / self._units


def reference(problem: Problem, cells: Cells, particles: float, **settings: Any) -> Array:
    """Flux on the cells by independent paths, of evenly spread numbers, with about so many particles."""
    tally = Tally(ParticleTracing, problem, cells, 12345, sampler="owen", **settings)
    tally.run(1)
    return tally.run(max(1, round(particles / tally.particles)))


def rms(found: Array, expected: Array) -> float:
    """Root mean square error of the cells, relative to the mean of those where light arrives."""
    lit = expected > 0.0
    return float(np.sqrt(np.mean((found - expected)[lit] ** 2)) / expected[lit].mean())
