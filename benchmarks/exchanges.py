"""Global lines of ``etendue.radiosity``: segments cast and replayed in a second, and the error that they leave.

The scene is the unit cube with four boxes floating in it. The error is that of F J for a radiosity J that varies
smoothly, relative for each patch, root mean square over patches. It is estimated from two runs of different seeds,
whose difference has the square root of two times the error of either.
"""

from __future__ import annotations

import itertools
from typing import Annotated, Any, get_args

import numpy as np
import typer

from etendue.radiosity import ABuffer, Backend, Patches, Segments, SpiralPoints, box, joined, solve

from .measuring import Record, timed
from .options import Bundles, Cells, named

_BOXES = (
    ((0.12, 0.15, 0.1), (0.42, 0.4, 0.55)),
    ((0.6, 0.1, 0.2), (0.85, 0.5, 0.45)),
    ((0.15, 0.6, 0.35), (0.45, 0.85, 0.9)),
    ((0.58, 0.62, 0.08), (0.88, 0.9, 0.62)),
)


def room(cells: int) -> Patches:
    """The scene, ``cells`` x ``cells`` quadrilaterals on a wall and about as large ones on the boxes."""
    boxes = [box(low, high, np.maximum(np.rint((np.array(high) - low) * cells), 1).astype(int)) for low, high in _BOXES]
    patches = Patches(*joined(box((0, 0, 0), (1, 1, 1), cells, inward=True), *boxes))
    lamp = (patches.centres[:, 2] == 1) & (np.abs(patches.centres[:, :2] - 0.5) < 0.2).all(axis=1)
    return patches.with_properties(reflectance=0.7, emission=lamp.astype(float))


def smooth_radiosity(centres: np.ndarray) -> np.ndarray:
    """J at ``centres`` (n, 3) in a unit cube, the radiosity whose irradiance is judged."""
    x, y, z = centres.T
    return np.exp(2 * x) * (1 + 0.5 * np.sin(7 * y + 5 * z))


def measure(
    sizes: Cells = "20,107",
    bundles: Bundles = 1024,
    lines: Annotated[
        float | None, typer.Option(min=1, help="Lines of a bundle; four for each patch by default, 16384 at least.")
    ] = None,
    backends: Annotated[
        Any,
        typer.Option(
            parser=named(get_args(Backend), "backend"),
            help="auto, compiled (Numba), drjit, separated by commas.",
            metavar="NAME,...",
        ),
    ] = "auto",
) -> Record:
    """Cast and replay ``bundles`` of so many ``lines`` through rooms of these numbers of cells, by these backends."""
    columns = (
        "patches",
        "backend",
        "segments",
        "cast s",
        "CPU s",
        "cast M/s",
        "replay M/s",
        "solve s",
        "error",
        "memory",
    )
    record = Record("Segments of a room with boxes", columns)
    for backend in backends:
        ABuffer(room(1), backend=backend).cast(1).gather(np.ones(len(room(1))))  # compiles
    for cells, backend in itertools.product(sizes, backends):
        patches = room(cells)
        radiosity = smooth_radiosity(patches.centres)
        gathered = []
        for seed in range(2):
            engine, found = ABuffer(patches, SpiralPoints(seed, bundles), lines, backend), list[Segments]()
            cast = timed(lambda engine=engine, found=found: found.append(engine.cast(bundles)))
            segments = found[0]
            results: list[np.ndarray] = []
            replay = timed(lambda s=segments, j=radiosity, out=results: out.append(s.gather(j)))
            gathered += results
        solution = timed(lambda p=patches, s=segments: solve(p, s, "conjugate-gradient", tolerance=1e-4))
        mean = (gathered[0] + gathered[1]) / 2
        error = np.sqrt(np.mean(((gathered[0] - gathered[1]) / mean) ** 2) / 2)
        count = len(segments) / 1e6
        record.add(
            *(
                str(len(patches)),
                engine.backend,
                f"{count:.1f} M",
                f"{cast.wall:.2f}",
                f"{cast.cpu:.2f}",
                f"{count / cast.wall:.1f}",
            ),
            *(f"{count / replay.wall:.0f}", f"{solution.wall:.2f}", f"{error:.2g}", f"{segments.nbytes / 1e9:.2f} GB"),
        )
    record.notes += [
        f"{bundles} bundles of {'the default number of' if lines is None else f'{lines:g}'} lines",
        "error: of F J for a smooth J, relative, root mean square over patches, from the difference of two runs",
        "solve: one channel, reflectance 0.7, conjugate gradient on the segments to a residual of 1e-4",
    ]
    return record
