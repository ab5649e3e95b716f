"""Methods that take turns on one scene, for the same time or the same samples each, and their error along the way."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from etendue import film, methods, scene
from etendue.core import Measurement, Replica

#: Share of the pixels, the worst, that errors leave out: a few pixels with a sliver of a lamp's mirror image in
#: them are as noisy by every method, and would drown all else.
TRIM = 0.001
#: Seed of the pass that only warms up, far from those that count.
_WARM_UP = 1 << 20

Image = NDArray[np.float32]
#: What is told of a picture at a mark: the entrant's label, the mark's number, the picture.
Look = Callable[[str, int, Image], None]


@dataclass(frozen=True)
class Entrant:
    """A method with its settings, under the name that the table shows."""

    label: str
    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def prepared(self, problem: Any, seed: int) -> Any:
        """The estimator, ready for its first pass; paths as long as the scene says, like those of its reference."""
        method = methods.get(self.method)
        estimator = method(method.Settings(**{"max_depth": problem.max_depth} | dict(self.settings)))
        estimator.prepare(problem, seed)
        return estimator


@dataclass(frozen=True)
class Point:
    """Where an entrant stands at a mark; the means over seeds, of the errors of their squares."""

    seconds: float  #: of its own, the pass that reached the mark included
    passes: float
    rms: float  #: of the difference of luminance from the reference, without the worst pixels
    untrimmed: float  #: the same with them
    samples: float = 0.0  #: camera paths of a pixel
    error: float = math.nan  #: standard error of ``rms``, from the scatter of the seeds; not a number for one seed

    @property
    def text(self) -> str:
        """``rms`` and, where it is known, its standard error."""
        return f"{self.rms:.4f}" + ("" if math.isnan(self.error) else f" ± {self.error:.4f}")


def marks(last: float, count: int = 8) -> list[float]:
    """``count`` times or numbers of samples, each twice the one before, up to ``last``."""
    return [last / 2.0**k for k in reversed(range(count))]


def race(
    problem: scene.Problem,
    entrants: Sequence[Entrant],
    reference: Image,
    at: Sequence[float],
    seeds: Sequence[int] = (0,),
    by: Literal["seconds", "samples"] = "seconds",
    look: Look | None = None,
    clock: Callable[[], float] | None = None,
) -> dict[str, list[Point]]:
    """Let every entrant render until the last mark of ``at``; a point a mark, that of the first pass that reaches it.

    The next pass is always that of the entrant which is least far, so that what else the machine does meets all alike.
    Only passes count: neither the compilation (a pass before the start) nor the looking at the picture. ``look`` is
    shown the pictures of the first seed. ``clock``: of the seconds, by default ``time.perf_counter``;
    ``time.process_time`` for a machine with other work.
    """
    clock = clock or time.perf_counter
    tracks: dict[str, list[list[Point]]] = {entrant.label: [] for entrant in entrants}
    for seed in seeds:
        runs = [_Run(entrant, problem, seed, by, clock) for entrant in entrants]
        while going := [run for run in runs if len(run.points) < len(at)]:
            run = min(going, key=lambda run: run.progress)
            run.go_on(reference, at, look if seed == seeds[0] else None)
        for run in runs:
            tracks[run.label].append(run.points)
    return {label: [_mean(points) for points in zip(*track, strict=True)] for label, track in tracks.items()}


class _Run:
    """One entrant under way with one seed."""

    def __init__(
        self, entrant: Entrant, problem: scene.Problem, seed: int, by: str, clock: Callable[[], float]
    ) -> None:
        self.label, self.seed, self.by, self.clock = entrant.label, seed, by, clock
        Replica(entrant.prepared(problem, seed), seed + _WARM_UP).step(0)
        self.replica = Replica(entrant.prepared(problem, seed), seed)  # anew: some learn
        self.measurement: Measurement | None = None
        self.seconds = 0.0
        self.samples = 0
        self.points: list[Point] = []

    @property
    def progress(self) -> float:
        """What the marks are of."""
        return self.seconds if self.by == "seconds" else self.samples

    def go_on(self, reference: Image, at: Sequence[float], look: Look | None) -> None:
        """A pass, and a point for each mark that it reaches."""
        start = self.clock()
        done = len(self.measurement.iterations) if self.measurement else 0
        measured = self.replica.step(done)
        self.seconds += self.clock() - start
        self.samples += self.replica.method.samples_per_iteration
        self.measurement = measured if self.measurement is None else self.measurement + measured
        reached = [mark for mark in at[len(self.points) :] if mark <= self.progress]
        if reached:
            image = self.replica.develop(self.measurement).image
            rms, untrimmed = film.luminance_rmse(image, reference, TRIM), film.luminance_rmse(image, reference)
            if look is not None:
                look(self.label, len(self.points) + len(reached) - 1, image)
            self.points += [Point(self.seconds, done + 1.0, rms, untrimmed, self.samples)] * len(reached)


def _mean(points: Sequence[Point]) -> Point:
    rows = np.array([(p.seconds, p.passes, p.rms**2, p.untrimmed**2, p.samples) for p in points])
    seconds, passes, square, untrimmed, samples = map(float, rows.mean(axis=0))
    rms, error = square**0.5, math.nan
    if len(points) > 1:
        scatter = float(rows[:, 2].std(ddof=1)) / len(points) ** 0.5
        error = scatter / (2.0 * rms) if rms > 0.0 else 0.0
    return Point(seconds, passes, rms, untrimmed**0.5, samples, error)


def order(tracks: Mapping[str, Sequence[Point]], index: int) -> str:
    """Labels by their error at a mark, the best first; ``≈`` joins two that differ by less than 3 %, or by less than
    twice the standard error of their difference."""
    ranked = sorted(((points[index], name) for name, points in tracks.items()), key=lambda pair: pair[0].rms)
    text = ranked[0][1]
    for (before, _), (point, name) in itertools.pairwise(ranked):
        noise = 0.0 if math.isnan(before.error + point.error) else 2.0 * math.hypot(before.error, point.error)
        alike = point.rms < max(1.03 * before.rms, before.rms + noise)
        text += (" ≈ " if alike else " < ") + name
    return text


#: What ``±`` and ``≈`` mean, for the notes of a table.
ORDER = "±: standard error, from the scatter of the seeds; ≈: within 3 %, or two standard errors of the difference"
