"""Methods that take turns on one scene, each for the same time of its own, and their error along the way."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue import film, methods, scene
from etendue.core import Measurement

from .scenes import SCENES

#: What the thesis sets, or does without a switch: as many light paths as pixels, connections with every vertex of the
#: light path of the same number, weights by the number of light paths, alpha = 2/3. Where it is silent: our defaults.
THESIS: Mapping[str, Any] = {"light_paths": 1.0, "light_source": "path", "eta_discount": 1.0, "alpha": 2.0 / 3.0}
#: The merge radius where the thesis gives none, in metres: the middle one of its sweep.
RADIUS = 0.012
#: Share of the pixels, the worst, that errors leave out: a few pixels with a sliver of a lamp's mirror image in
#: them are as noisy by every method, and would drown all else.
TRIM = 0.001
#: Seed of the passes that only warm up, far from those that count.
_WARM_UP = 1 << 20

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Entrant:
    """A method with its settings, under the name that the table shows."""

    label: str
    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def prepared(self, problem: Any, seed: int) -> Any:
        """The estimator, ready for its first pass."""
        method = methods.get(self.method)
        estimator = method(method.Settings(**self.settings))
        estimator.prepare(problem, seed)
        return estimator


def merging(method: str, radius: float = RADIUS, **more: Any) -> dict[str, Any]:
    """Settings of ``bpt``, ``bpm`` or ``vcm`` as in the thesis; ``radius`` is in metres."""
    if method == "bpt":
        return dict(THESIS, **more)
    return dict(THESIS, radius=radius, radius_unit="absolute", **more)


def the_four(radius: float = RADIUS) -> list[Entrant]:
    """VCM, BPT, BPM and PT as the thesis compares them: VCM without merging at the first camera vertex."""
    return [
        Entrant("vcm", "vcm", merging("vcm", radius, merge_first=False)),
        Entrant("bpt", "bpt", merging("bpt")),
        Entrant("bpm", "bpm", merging("bpm", radius)),
        Entrant("path", "path"),
    ]


def open_scene(name: str, size: tuple[int, int]) -> scene.Problem:
    """A scene of the experiments, loaded at a size."""
    return scene.load(SCENES[name](), size=size)


@dataclass(frozen=True)
class Point:
    """Where an entrant stands at a mark; the means over seeds, of the errors of their squares."""

    seconds: float  #: of its own, the pass that reached the mark included
    passes: float
    rms: float  #: of the difference of luminance from the reference, without the worst pixels
    untrimmed: float  #: the same with them


def marks(seconds: float, count: int = 8) -> list[float]:
    """``count`` times, each twice the one before, the last one ``seconds``."""
    return [seconds / 2.0**k for k in reversed(range(count))]


def race(
    problem: scene.Problem,
    entrants: Sequence[Entrant],
    reference: Image,
    times: Sequence[float],
    seeds: Sequence[int] = (0,),
) -> dict[str, list[Point]]:
    """Let every entrant render until the last of ``times``; a point a time, that of the first pass that reaches it.

    The next pass is always that of the entrant which has used the least time, so that what else the machine does meets
    all alike. Only passes count: neither the compilation (a pass before the start) nor the looking at the picture.
    """
    tracks: dict[str, list[list[Point]]] = {entrant.label: [] for entrant in entrants}
    for seed in seeds:
        runs = [_Run(entrant, problem, seed) for entrant in entrants]
        while going := [run for run in runs if len(run.points) < len(times)]:
            run = min(going, key=lambda run: run.seconds)
            run.go_on(reference, times)
        for run in runs:
            tracks[run.label].append(run.points)
    return {label: [_mean(points) for points in zip(*track, strict=True)] for label, track in tracks.items()}


class _Run:
    """One entrant under way with one seed."""

    def __init__(self, entrant: Entrant, problem: scene.Problem, seed: int) -> None:
        self.label, self.seed = entrant.label, seed
        self.estimator = entrant.prepared(problem, seed)
        self.estimator.step(0, seed + _WARM_UP)
        self.measurement: Measurement | None = None
        self.seconds = 0.0
        self.points: list[Point] = []

    def go_on(self, reference: Image, times: Sequence[float]) -> None:
        """A pass, and a point for each time that it reaches."""
        start = time.perf_counter()
        done = len(self.measurement.iterations) if self.measurement else 0
        measured = self.estimator.step(done, self.seed)
        self.seconds += time.perf_counter() - start
        self.measurement = measured if self.measurement is None else self.measurement + measured
        reached = [mark for mark in times[len(self.points) :] if mark <= self.seconds]
        if reached:
            image = self.estimator.develop(self.measurement).image
            rms, untrimmed = film.luminance_rmse(image, reference, TRIM), film.luminance_rmse(image, reference)
            self.points += [Point(self.seconds, done + 1.0, rms, untrimmed)] * len(reached)


def _mean(points: Sequence[Point]) -> Point:
    rows = np.array([(p.seconds, p.passes, p.rms**2, p.untrimmed**2) for p in points]).mean(axis=0)
    return Point(float(rows[0]), float(rows[1]), float(np.sqrt(rows[2])), float(np.sqrt(rows[3])))


def order(tracks: Mapping[str, Sequence[Point]], index: int) -> str:
    """Labels by their error at a mark, the best first; ``≈`` joins those within 3 %."""
    ranked = sorted((points[index].rms, name) for name, points in tracks.items())
    text = ranked[0][1]
    for (before, _), (error, name) in itertools.pairwise(ranked):
        text += (" ≈ " if error < 1.03 * before else " < ") + name
    return text
