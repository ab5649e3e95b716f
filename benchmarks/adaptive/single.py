"""One path an evaluation, or one of each length (section 5.4.1 of the thesis): which of them lets VEGAS learn more."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from etendue import film, scene
from etendue.core import Replica

from ..measuring import Record
from ..options import Out, ReferenceSeconds, Seeds
from ..racing import TRIM, Entrant, Image
from .entrants import PER_PASS, integrand, recipe
from .options import BOXES, OUT, PictureSize, Samples, Scenes
from .scenes import SIZES, open_scene

#: More passes than any run has: what is learned after these is never used.
_NEVER = 1 << 30


def measure(
    scenes: Scenes = BOXES,
    size: PictureSize = None,
    samples: Samples = 256,
    seeds: Seeds = 3,
    reference_seconds: ReferenceSeconds = 60.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _scene(name, size or SIZES[name], samples, seeds, out, reference_seconds)


def _scene(name: str, size: tuple[int, int], samples: int, seeds: int, out: Path, reference_seconds: float) -> Record:
    """Errors at equal samples and at equal rays, with and without learning."""
    reference = recipe(name).find(size, out, reference_seconds)
    problem = open_scene(name, size)
    passes = max(1, samples // PER_PASS)
    learning = integrand(name) | {"groups": "light; bounce1; bounce2"}
    entrants = {
        ("each length", "even"): Entrant("", "path", integrand(name)),
        ("each length", "learned"): Entrant("", "vegas", learning),
        ("one length", "even"): Entrant("", "vegas", learning | {"one_path": True, "update": _NEVER}),
        ("one length", "learned"): Entrant("", "vegas", learning | {"one_path": True}),
    }
    found = {key: _mean_error(e, problem, reference.image, passes, seeds) for key, e in entrants.items()}
    record = Record(
        f"One path or one of each length, {name}, {size[0]}x{size[1]}, {passes * PER_PASS} samples a pixel",
        ("", "density", "RMS", "rays a sample", "variance at equal rays", "variance that learning leaves"),
    )
    first, first_rays = found["each length", "learned"]
    for (lengths, density), (rms, rays) in found.items():
        at_equal_rays = (rms / first) ** 2 * rays / first_rays
        left = (rms / found[lengths, "even"][0]) ** 2
        record.add(lengths, density, f"{rms:.4f}", f"{rays:.2f}", f"{at_equal_rays:.2f}", f"{left:.2f}")
    record.notes += [
        "variance at equal rays: square of the RMS times rays, relative to one path of each length with learning",
        "one length: drawn from six, the last for all longer; 'even' draws them, and all else, evenly",
        f"RMS of luminance without the worst {TRIM:.1%} of the pixels, {seeds} seed(s); reference: {reference.note}",
    ]
    return record


def _mean_error(
    entrant: Entrant, problem: scene.Problem, reference: Image, passes: int, seeds: int
) -> tuple[float, float]:
    """(RMS over seeds, rays of a sample)."""
    squares, rays = [], 0.0
    for seed in range(seeds):
        replica = Replica(entrant.prepared(problem, seed), seed)
        total: Any = None
        for number in range(passes):
            measured = replica.step(number)
            total = measured if total is None else total + measured
        squares.append(film.luminance_rmse(total.mean("image"), reference, TRIM) ** 2)
        rays += total.counters["rays"] / total.counters["paths"]
    return float(np.sqrt(np.mean(squares))), rays / seeds
