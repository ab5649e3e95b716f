"""Correctness (table 5.1 of the thesis): VCM and BPT against path tracing on a plain diffuse scene.

If the methods agree, the RMS of the difference is noise: it falls as 1 / sqrt(passes). Independent random numbers, so
that the variance over the passes can be measured, and two tests of the mean differences of blocks of pixels:

- z is a block's mean difference over its standard error from the n passes of a run. Without bias z^2 has the mean
  (n - 1) / (n - 3), that of Student's t squared. Blocks of a run share light paths, so their z are not independent; the
  runs are, a seed each: Student's test of the runs' means of z^2, one-sided, asks whether it is larger.
- The products of a block's mean differences in two runs average to the square of its bias, whatever the noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from etendue import film
from etendue.core import Replica

from .. import plotting
from ..measuring import Record
from ..options import Out, Size
from ..racing import Entrant
from .entrants import merging, open_scene
from .options import OUT, SIZE, Radii, Scenes

_BLOCK = 16
Array = NDArray[np.float64]


def measure(
    scenes: Scenes = "diffuse",
    size: Size = SIZE,
    passes: Annotated[int, typer.Option(min=4, help="Passes of each method.")] = 128,
    seeds: Annotated[int, typer.Option(min=1, help="Independent runs; the tests need two.")] = 5,
    millimetres: Radii = "1,12",
    out: Out = OUT,
) -> Iterator[Record]:
    """Two tables of each scene."""
    for name in scenes:
        yield from _scene(name, size, passes, seeds, millimetres, out)


def _scene(
    name: str, size: tuple[int, int], passes: int, seeds: int, millimetres: Sequence[float], out: Path
) -> list[Record]:
    """The RMS of the differences at growing numbers of passes, and the tests of the blocks at the end; ``vcm`` with
    each first radius of ``millimetres``."""
    problem = open_scene(name, size)
    common = {"sampler": "independent", "samples_per_pass": 1}
    entrants = [
        Entrant("path", "path", common),
        *(
            Entrant(f"vcm, {r:g} mm", "vcm", merging("vcm", r / 1000.0, merge_first=False, **common))
            for r in millimetres
        ),
        Entrant("bpt", "bpt", merging("bpt", **common)),
    ]
    runs = [_run(problem, entrants, passes, seed, _block(size)) for seed in range(seeds)]
    others = [entrant.label for entrant in entrants[1:]]
    at = [done for done, _ in runs[0].errors[others[0]]]
    rms = {
        label: [
            (done, float(np.sqrt(np.mean([run.errors[label][k][1] ** 2 for run in runs])))) for k, done in enumerate(at)
        ]
        for label in others
    }
    plotting.save(out / f"correctness-{name}.svg", {f"{k} - path": v for k, v in rms.items()}, "Difference", "passes")
    where = f"{name}, {size[0]}x{size[1]}"
    bright = float(np.mean([run.bright for run in runs]))
    blocks = {label: np.array([run.blocks[label] for run in runs]) for label in others}
    return [_differences(where, rms, bright, seeds), _residual(where, blocks, _block(size), bright)]


@dataclass
class _Run:
    """What a seed gives: of every method but ``path``, its difference from that."""

    errors: dict[str, list[tuple[float, float]]]  #: RMS of luminance at numbers of passes
    blocks: dict[str, list[Array]]  #: differences of the blocks' luminance, an array a pass
    bright: float  #: mean luminance


def _run(problem: Any, entrants: Sequence[Entrant], passes: int, seed: int, factor: int) -> _Run:
    # A seed each: the random numbers of a role are the same in every method.
    replicas = {e.label: Replica(e.prepared(problem, seed), seed + 1000 * k) for k, e in enumerate(entrants)}
    others = [label for label in replicas if label != "path"]
    sums: dict[str, Any] = {}
    run = _Run({label: [] for label in others}, {label: [] for label in others}, 0.0)
    for number in range(passes):
        for label, replica in replicas.items():
            measured = replica.step(number)
            sums[label] = measured if label not in sums else sums[label] + measured
            values = film.block_average(measured.mean("image") @ np.array(film.LUMINANCE), factor)
            if label == "path":
                own = values
            else:
                run.blocks[label].append(values - own)
        done = number + 1
        if done & number == 0 or done == passes:  # powers of two, and the end
            means = {label: measured.mean("image") for label, measured in sums.items()}
            for label in others:
                run.errors[label].append((float(done), film.luminance_rmse(means[label], means["path"])))
    run.bright = float((sums["path"].mean("image") @ np.array(film.LUMINANCE)).mean())
    return run


def _block(size: tuple[int, int]) -> int:
    """Side of a block of pixels that divides the picture."""
    return next(side for side in range(_BLOCK, 0, -1) if size[0] % side == 0 and size[1] % side == 0)


def _differences(where: str, rms: dict[str, list[tuple[float, float]]], bright: float, seeds: int) -> Record:
    record = Record(f"Correctness: RMS of luminance, {where}", ("passes", *(f"{label} - path" for label in rms)))
    for rows in zip(*rms.values(), strict=True):
        record.add(f"{rows[0][0]:.0f}", *(f"{error:.5f}" for _, error in rows))
    slopes = []
    for points in rms.values():
        x, y = np.log(np.array(points)).T
        slopes.append(f"{np.polyfit(x, y, 1)[0]:.3f}" if len(x) > 1 else "none")
    record.add("slope", *slopes)
    record.notes += [
        "slope: of the logarithms, least squares; noise has -0.5, a bias that stays bends the curve to 0",
        f"mean luminance of the scene {bright:.4f}; independent random numbers, one sample a pixel and pass, "
        f"root of the mean of {seeds} seed{'s' if seeds > 1 else ''}",
        "vcm: radius in the first pass, alpha 2/3, no merging at the first camera vertex",
        "thesis: RMS 0.006 between 3657 passes of PT and 929 of VCM",
    ]
    return record


def _residual(where: str, blocks: dict[str, Array], side: int, bright: float) -> Record:
    """The tests of the blocks; ``blocks``: differences, (seeds, passes, rows, columns)."""
    record = Record(
        f"Correctness: residual in blocks of {side}x{side}, {where}",
        ("", "mean of z²", "its p", "largest |z|", "mean difference", "its p", "RMS of the bias"),
    )
    for label, values in blocks.items():
        seeds, count = values.shape[:2]
        means = values.mean(axis=1)
        z = means / np.maximum(values.std(axis=1, ddof=1), 1e-12) * np.sqrt(count)
        expected = (count - 1) / (count - 3)
        squares, whole = (z**2).mean(axis=(1, 2)), means.mean(axis=(1, 2)) / bright
        square = 0.0
        if seeds > 1:
            square = float(((means.sum(axis=0) ** 2 - (means**2).sum(axis=0)) / (seeds * (seeds - 1))).mean())
        record.add(
            f"{label} - path",
            _with_error(squares, ".3f"),
            _student(squares - expected, "greater"),
            f"{np.abs(z).max():.2f}",
            _with_error(100.0 * whole, "+.3f") + " %",
            _student(whole, "two-sided"),
            f"{100.0 * np.sign(square) * np.sqrt(abs(square)) / bright:.3f} %" if seeds > 1 else "one seed",
        )
    record.notes += [
        f"{seeds} seeds of {count} passes, {z[0].size} blocks; ±: standard error over the seeds; p: probability of as "
        "much or more without bias, by Student's test over the seeds",
        "z: mean difference of a block's luminance over its standard error from the passes of a seed; without bias the "
        f"mean of z² is {expected:.3f}, and p is one-sided",
        "mean difference: of the picture, relative to its luminance; p is two-sided",
        "RMS of the bias: of the blocks, relative to the mean luminance, from the products of the differences in two "
        "seeds; below 0 where these average to less",
    ]
    return record


def _with_error(values: Array, form: str) -> str:
    error = f" ± {values.std(ddof=1) / np.sqrt(len(values)):.3f}" if len(values) > 1 else ""
    return f"{values.mean():{form}}{error}"


def _student(values: Array, alternative: str) -> str:
    """Probability of such values, a seed each, if their mean is 0."""
    if len(values) < 2:
        return "one seed"
    from scipy import stats

    return f"{stats.ttest_1samp(values, 0.0, alternative=alternative).pvalue:.3f}"
