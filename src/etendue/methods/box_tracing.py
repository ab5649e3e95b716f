"""Particle tracing in a scene that is divided into boxes, one process each, see :mod:`etendue.particles.boxes`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Iterations, Measurement, Record, UnsupportedError, copied_to_device
from etendue.particles import (
    WORDS,
    BoxGrid,
    BoxWalk,
    ParticleStore,
    ParticleWalk,
    columns_of,
    in_path_order,
)
from etendue.scene import Problem

from .base import total
from .particles import PATHS, RECORD, ParticleSettings, ParticleTracing

#: Particles, records of paths that leave the box, and counters.
Carried = tuple[NDArray[np.uint32], NDArray[np.uint32], dict[str, float]]

_NO_PARTICLES = np.zeros((0, WORDS + 1), np.uint32)
#: First capacity of a store in a box: particles for each path, and a number of particles added to them.
_EACH, _LEAST = 4, 1024


class BoxTracing(ParticleTracing):
    """Particle tracing by a process that has the shapes of one box only.

    box: number of the box in ``grid``. shapes: for each shape of the process, its index in the whole scene."""

    def __init__(self, settings: ParticleSettings, grid: BoxGrid, box: int, shapes: Sequence[int]) -> None:
        super().__init__(settings)
        self._grid, self._box, self._numbers = grid, box, np.array(shapes, np.uint32)

    def prepare(self, problem: Problem, seed: int) -> None:
        """Build the tables."""
        self._build(problem, seed)

    def _walk_of(self, **options: Any) -> ParticleWalk:
        return BoxWalk(grid=self._grid, box=self._box, **options)

    @property
    def _boxes(self) -> BoxWalk:
        assert isinstance(self._walk, BoxWalk)
        return self._walk

    def emit(self, iteration: int, seed: int, first: int, count: int) -> Carried:
        """The paths ``first`` to ``first + count`` of a pass before their first edge, as records for their boxes."""
        number = dr.opaque(mi.UInt32, first) + dr.arange(mi.UInt32, count)
        source = self._source(number, self.samples_per_iteration, seed, iteration)
        return _NO_PARTICLES, self._boxes.emitted(count, source, number), {PATHS: float(count)}

    def carry(self, iteration: int, seed: int, paths: NDArray[np.uint32]) -> Carried:
        """Trace paths until they end or leave the box."""
        capacity = _EACH * len(paths) + _LEAST
        number = copied_to_device(mi.UInt32, np.ascontiguousarray(paths[:, 0]))
        source = self._source(number, self.samples_per_iteration, seed, iteration)
        while True:
            store = ParticleStore(capacity, self._table)
            path, leaving = self._boxes.carry(paths, source, store)
            dr.schedule(path.rays, path.nonfinite)
            leaving.launch()
            store.launch()
            if store.count <= capacity:
                break
            capacity = store.count
        rows = np.array(store.numbered())
        shape = rows[:, columns_of("shape")]
        shape[:] = self._numbers[shape]
        counters = {RECORD: float(len(rows)), "rays": total(path.rays), "nonfinite": total(path.nonfinite)}
        return rows, leaving.rows(), counters


def make_box_tracing(settings: ParticleSettings, problem: Problem, **given: NDArray[Any]) -> BoxTracing:
    """Make the method in a worker; the inverse of :func:`box_arguments`."""
    grid = BoxGrid(tuple(tuple(map(float, given[f"planes{axis}"])) for axis in range(3)))
    whole = [str(name) for name in given["names"]]
    here = [whole.index(str(shape.id())) for shape in problem.scene.shapes()]
    return BoxTracing(settings, grid, int(given["box"]), here)


def box_arguments(grid: BoxGrid, box: int, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Arguments of :func:`make_box_tracing` for a recipe; ``names``: ids of the shapes of the whole scene."""
    planes = {f"planes{axis}": np.array(grid.planes[axis], np.float64) for axis in range(3)}
    return planes | {"box": np.array(box), "names": np.array(names, dtype=str)}


def check_divisible(tracing: ParticleTracing) -> None:
    """Raise :class:`UnsupportedError` for lights that a process with a part of the scene cannot sample."""
    if tracing.lights.has_infinite:
        raise UnsupportedError(
            "an environment or directional light sends rays from around the whole scene, which no worker has: leave "
            "the scene undivided"
        )
    if tracing.settings.emission == "importance":
        raise UnsupportedError("emission by importance needs the whole scene: take another, or leave it undivided")


def gathered(iteration: int, products: Sequence[NDArray[np.uint32]], counters: dict[str, float]) -> Measurement:
    """The measurement of a pass from the particles of all boxes; equal to that of :class:`ParticleTracing`, except that
    ``rays`` counts a ray in each box that it crosses."""
    rows = in_path_order(np.concatenate([_NO_PARTICLES, *products]))
    every = {PATHS: 0.0, RECORD: 0.0, "rays": 0.0, "nonfinite": 0.0} | counters
    return Measurement(
        {}, {}, Iterations.single(iteration), counters=every, records={RECORD: Record.single(rows, iteration)}
    )
