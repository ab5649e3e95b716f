"""``path`` by each ``sampler`` and ``scrambling``: error at equal samples, likeness of errors of near pixels."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer

from etendue import film, methods, scene
from etendue.core import Replica
from etendue.scene import Problem

from .choice import scaled_size
from .measuring import Record, console
from .options import Names, Pixels, Seeds, whole_numbers

#: Sampler and scrambling.
_ENTRANTS = (
    ("owen", ""),
    ("independent", ""),
    ("halton", "digits"),
    ("halton", "shift"),
    ("halton", "same"),
    ("hammersley", "digits"),
    ("hammersley", "shift"),
    ("hammersley", "same"),
)
#: Samples of the reference relative to the most of a picture.
_LONGER = 64
_PASS = 64


def picture(problem: Problem, sampler: str, scrambling: str, spp: int, seed: int) -> tuple[np.ndarray, float]:
    """A picture in passes of at most 64 samples, and the CPU seconds of the passes."""
    method, samples = methods.get("path"), min(spp, _PASS)
    settings = {"sampler": sampler, "samples_per_pass": samples, "max_depth": problem.max_depth}
    path = method(method.Settings(**settings, **({"scrambling": scrambling} if scrambling else {})))
    path.prepare(problem, seed)
    replica, began = Replica(path, seed), time.process_time()
    total = replica.step(0)
    for iteration in range(1, spp // samples):
        total += replica.step(iteration)
    return replica.develop(total).image, time.process_time() - began


def likeness(error: np.ndarray) -> float:
    """Correlation of the errors of pixels two apart, beyond the reach of most filters, relative to their scale."""
    luminance = error.mean(axis=2)
    first, second = luminance[:, :-2].ravel(), luminance[:, 2:].ravel()
    bright = np.quantile(np.abs(luminance), 0.99)  # fireflies are not a pattern
    return float(np.corrcoef(first.clip(-bright, bright), second.clip(-bright, bright))[0, 1])


def measure(
    scenes: Names = "cornell-box,skylight",
    pixels: Pixels = 9216,
    spp: Annotated[
        str, typer.Option(parser=whole_numbers, help="Samples a pixel, powers of two.", metavar="N,...")
    ] = "16,64",
    seeds: Seeds = 5,
) -> Iterator[Record]:
    """Every sampler on every scene."""
    for name in scenes:
        problem = scene.load(name, size=scaled_size(name, pixels, larger=True))
        reference, _ = picture(problem, "owen", "", _LONGER * max(spp), 977)  # type: ignore[type-var, operator]
        record = Record(
            f"samplers of path on {name}, {problem.size[0]}x{problem.size[1]}",
            ("sampler", "scrambling", "spp", "relMSE", "to owen", "likeness", "CPU s"),
        )
        for samples in spp:
            owen = math.nan
            for sampler, scrambling in _ENTRANTS:
                errors, alike, seconds = [], [], []
                for seed in range(seeds):
                    image, spent = picture(problem, sampler, scrambling, int(samples), seed)
                    errors.append(film.relative_mse(image, reference))
                    alike.append(likeness((image - reference) / np.sqrt(reference**2 + 0.01)))
                    seconds.append(spent)
                mean, error = np.mean(errors), np.std(errors, ddof=1) / math.sqrt(seeds)
                owen = mean if sampler == "owen" else owen
                cells = [sampler, scrambling, str(samples), f"{mean:.5f} ± {error:.5f}", f"{mean / owen:.2f}"]
                cells += [f"{np.mean(alike):.2f}", f"{min(seconds):.2f}"]
                record.add(*cells)
                console.print("  ".join([name, *cells]), style="dim")
        record.notes.append(
            f"mean of {seeds} seeds and its standard error; likeness: correlation of the errors of pixels two apart; "
            f"reference: owen, {_LONGER * max(spp)} samples"  # type: ignore[type-var, operator]
        )
        yield record
