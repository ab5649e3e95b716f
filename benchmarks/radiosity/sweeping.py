"""Errors over numbers of lines and seeds, their ratios and slopes, and how exactly these are known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from etendue.core import Array
from etendue.points import PointSet
from etendue.radiosity import ChainedRays, LineGenerator, Multipath, RayScene, SpherePairs, first_shot, multipath

from ..measuring import timed

#: A squared error of a run with so many lines and a seed.
Task = Callable[[int, int], float]
Name = TypeVar("Name")
#: Seeds of local lines are so far from those of global lines.
_LOCAL = 10_000


@dataclass(frozen=True)
class Track:
    """What a task came to: ``lines`` (m,), and for each seed and number of lines its ``errors`` and ``seconds``."""

    lines: Array
    errors: Array  #: (s, m)
    seconds: Array  #: (s, m)

    @property
    def mean(self) -> Array:
        """(m,) mean squared errors."""
        return self.errors.mean(axis=0)

    @property
    def points(self) -> list[tuple[float, float]]:
        """(lines, error), for a plot."""
        return [(float(x), float(y)) for x, y in zip(self.lines, self.mean, strict=True)]

    @property
    def points_in_time(self) -> list[tuple[float, float]]:
        """(median seconds, error), for a plot."""
        return [(float(x), float(y)) for x, y in zip(np.median(self.seconds, axis=0), self.mean, strict=True)]

    def slope(self, x: Array | None = None) -> Known:
        """Of the logarithm of the error over that of ``x``, by default the lines."""
        places = np.log(self.lines if x is None else x)

        def fit(errors: Array) -> float:
            return float(np.polyfit(places, np.log(errors.mean(axis=0)), 1)[0])

        return jackknife(fit, self.errors)

    def ratio(self, other: Track, marks: int = 1) -> Known:
        """Of the errors to those of another, at the last ``marks`` numbers of lines: their geometric mean."""

        def quotient(pair: Array) -> float:
            mine, theirs = pair.mean(axis=0)
            return float(np.exp(np.log(mine / theirs).mean()))

        return jackknife(quotient, np.stack([self.errors, other.errors], axis=1)[:, :, -marks:])


@dataclass(frozen=True)
class Known:
    """A value and its standard error."""

    value: float
    error: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ± {self.error:.2f}"


def jackknife(function: Callable[[Array], float], rows: Array) -> Known:
    """A function of all seeds (rows), and its standard error from leaving out one after the other."""
    count = len(rows)
    if count < 2:
        return Known(function(rows), float("nan"))
    left = np.array([function(np.delete(rows, row, axis=0)) for row in range(count)])
    return Known(function(rows), float(np.sqrt((count - 1) * left.var())))


def marks(most: int, least: int) -> list[int]:
    """``most``, half of it, and so on while that is at least ``least``, ascending; two at least."""
    halvings = range(max(most // max(least, 1), 2).bit_length() - 1, -1, -1)
    return [most >> k for k in halvings]


def sweep(tasks: Mapping[Name, Task], lines: Sequence[int], seeds: int) -> dict[Name, Track]:
    """Every task with every number of lines and every seed, in turn, so that what else the machine does meets all
    alike. Each is tried once before the clock runs."""
    shape = seeds, len(lines)
    errors, seconds = ({name: np.empty(shape) for name in tasks} for _ in range(2))
    for task in tasks.values():
        task(lines[0], seeds)
    for seed in range(seeds):
        for mark, count in enumerate(lines):
            for name, task in tasks.items():
                found: list[float] = []
                clock = timed(lambda task=task, n=count, s=seed, out=found: out.append(task(n, s)))
                errors[name][seed, mark], seconds[name][seed, mark] = found[0], clock.wall
    return {name: Track(np.array(lines, dtype=float), errors[name], seconds[name]) for name in tasks}


class WholeRays(ChainedRays):
    """All lines in one piece: less often a few rays at a time."""

    def piece(self, count: int) -> int:
        """See :class:`etendue.radiosity.LineEngine`."""
        return count


def half_and_half(
    scene: RayScene,
    driver: Callable[[int, int], PointSet],
    lines: int,
    seed: int,
    generator: LineGenerator | None = None,
) -> Multipath:
    """Multipath line by line with ``lines`` lines after a first shot of as many, the setting of the thesis."""
    generator = SpherePairs(scene.patches) if generator is None else generator
    points = max(round(lines / generator.lines_per_point), 1)
    shot = first_shot(scene, driver(lines, seed + _LOCAL).block(lines))
    return multipath(WholeRays(generator, scene, driver(points, seed)), points, shot=shot)


def shot_only(scene: RayScene, driver: Callable[[int, int], PointSet], lines: int, seed: int) -> Array:
    """Radiosity (n, c) after the first shot of :func:`half_and_half`: emission, and what it lights directly."""
    shot = first_shot(scene, driver(lines, seed + _LOCAL).block(lines))
    return scene.patches.emission + shot.reflected / scene.patches.areas[:, None]
