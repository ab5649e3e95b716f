"""Form factors of cities of 24 to 100,000 facets, by lines and by integrals: CPU time, and the errors at that time.

A city has k x k equal blocks of 4 x 4 cells, with a building of 2 x 2 cells, one to four high, in the middle of each.
Lines: errors of sky view factors and of F J for a radiosity J that varies smoothly, in units of its mean, root mean
square over facets, from two runs of different seeds, whose difference has the square root of two times the error of
either. Integrals: from a run of more lines.
"""

from __future__ import annotations

import time
from typing import Annotated, Any

import numpy as np
import typer

from etendue.radiosity import ABuffer, Patches, Segments, SpiralPoints, exact_form_factors

from .exchanges import smooth_radiosity
from .measuring import Record, rms, verdict
from .options import Bundles, whole_numbers

#: Facets up to which integrals are computed, and how many times the bundles of a run they are compared to.
_MOST_EXACT, _MORE = 5000, 16
#: Lines of a bundle for each facet, by default and of cities with bars, and how many times the bundles these have.
_LINES, _MORE_LINES, _TIMES = 4, 32, 1.5
#: Errors of sky view factors and of F J, and CPU seconds, in cities of so many facets.
_ERROR_BARS, _TIME_BARS = {22488: 2e-3}, {22488: 60.0}


def city(blocks: int) -> Patches:
    """The city, in the unit square."""
    heights = np.random.default_rng(1).permutation(np.resize([1, 2, 3, 4], blocks * blocks)).reshape(blocks, blocks)
    levels = np.kron(heights, np.pad(np.ones((2, 2), int), 1))  # of the cells
    size, faces = 4 * blocks, []
    for i, j in np.ndindex(size, size):
        low = levels[i, j]
        faces.append([(i, j, low), (i + 1, j, low), (i + 1, j + 1, low), (i, j + 1, low)])
        for di, dj, (ax, ay), (bx, by) in _SIDES:
            beside = (i + di, j + dj)
            other = levels[beside] if min(beside) >= 0 and max(beside) < size else low
            for z in range(other, low):
                faces.append(
                    [(i + ax, j + ay, z), (i + bx, j + by, z), (i + bx, j + by, z + 1), (i + ax, j + ay, z + 1)]
                )
    corners = np.array(faces, float).reshape(-1, 3)
    vertices, places = np.unique(corners, axis=0, return_inverse=True)
    return Patches(vertices / size, places.reshape(-1, 4))


#: The four sides of a cell: the neighbour, and the ends of its edge, counterclockwise as seen from there.
_SIDES = ((1, 0, (1, 0), (1, 1)), (-1, 0, (0, 1), (0, 0)), (0, 1, (1, 1), (0, 1)), (0, -1, (0, 0), (1, 0)))


def measure(
    blocks: Annotated[
        Any, typer.Option(parser=whole_numbers, help="Along a side of the city, separated by commas.", metavar="N,...")
    ] = "1,5,10,25,53",
    bundles: Bundles = 1024,
    tolerance: Annotated[float, typer.Option(help="Of rows by integrals.")] = 1e-3,
) -> Record:
    """Cities of these numbers of blocks."""
    record = Record("Form factors of cities", ("", "facets", "CPU s", "s", "sky error", "F J error", "memory"))
    ABuffer(city(1)).cast(1).gather(np.ones(len(city(1))))  # loads or compiles
    exact_form_factors(city(1))
    for count in blocks:
        patches = city(count)
        radiosity, n = smooth_radiosity(patches.centres), str(len(patches))
        runs = [(bundles, _LINES), (round(_TIMES * bundles), _MORE_LINES)]
        for number, lines in runs if len(patches) in _ERROR_BARS else runs[:1]:
            found: list[tuple[np.ndarray, np.ndarray]] = []
            for seed in range(2):
                segments, cpu, wall = _cast(patches, seed, number, lines)
                found.append((_sky(segments), segments.gather(radiosity)))
            (sky, other_sky), (gathered, other) = zip(*found, strict=True)
            mean = gathered.mean()
            errors = rms(sky - other_sky) / np.sqrt(2), rms(gathered - other) / mean / np.sqrt(2)
            cells = *(f"{cpu:.2f}", f"{wall:.2f}"), *(f"{error:.2g}" for error in errors)
            record.add(f"{number} bundles of {lines}", n, *cells, f"{segments.nbytes / 1e9:.2f} GB")
        if bar := _ERROR_BARS.get(len(patches)):
            judged = verdict(max(errors), bar), f"CPU s {verdict(cpu, _TIME_BARS[len(patches)])}"
            record.notes.append(
                f"{n} facets, {number} bundles of {lines}: error {max(errors):.2g}, {'; '.join(judged)}"
            )
        if len(patches) > _MOST_EXACT:
            continue
        began = time.process_time(), time.perf_counter()
        factors = exact_form_factors(patches, tolerance)
        spent = time.process_time() - began[0], time.perf_counter() - began[1]
        reference, _, _ = _cast(patches, 2, _MORE * bundles, _LINES)
        off = factors.sky - _sky(reference), (factors.matrix @ radiosity - reference.gather(radiosity)) / mean
        record.add("integrals", n, *(f"{seconds:.2f}" for seconds in spent), *(f"{rms(x):.2g}" for x in off), "")
    record.notes.append(
        f"bundles of so many lines a facet; integrals: rows to {tolerance:g}, beside {_MORE * bundles} bundles with "
        "their error"
    )
    return record


def _cast(patches: Patches, seed: int, bundles: int, lines: int) -> tuple[Segments, float, float]:
    """(segments, CPU seconds, seconds); ``lines`` of a bundle for each facet."""
    began = time.process_time(), time.perf_counter()
    segments = ABuffer(patches, SpiralPoints(seed, bundles), lines * len(patches)).cast(bundles)
    return segments, time.process_time() - began[0], time.perf_counter() - began[1]


def _sky(segments: Segments) -> np.ndarray:
    """The share of the sky in what each facet sees."""
    return 1 - segments.gather(np.ones(len(segments.dark))) - segments.dark
