"""Correctness (table 5.1 of the thesis): VCM and BPT against path tracing on a plain diffuse scene.

If the methods agree, the RMS of the difference is noise: it falls as 1 / sqrt(passes), and the mean differences of
blocks of pixels are as small as their variance over the passes says. Independent random numbers, so that this variance
can be measured.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue import film

from .. import plotting
from ..measuring import Record
from ..racing import Entrant
from .entrants import merging, open_scene

_BLOCK = 16
#: A block's test value beyond which it counts as an outlier, and the share of those among normal numbers.
_OUTLIER, _EXPECTED = 2.5758, 0.01


def measure(name: str, size: tuple[int, int], passes: int, seed: int, out: Path) -> list[Record]:
    """The RMS of the differences at growing numbers of passes, and the test of the blocks at the end."""
    problem = open_scene(name, size)
    common = {"sampler": "independent", "samples_per_pass": 1}
    entrants = [
        Entrant("path", "path", common),
        Entrant("vcm", "vcm", merging("vcm", merge_first=False, **common)),
        Entrant("bpt", "bpt", merging("bpt", **common)),
    ]
    estimators = {entrant.label: entrant.prepared(problem, seed) for entrant in entrants}
    others = [label for label in estimators if label != "path"]
    factor = _block(size)
    sums: dict[str, Any] = {}
    blocks: dict[str, list[NDArray[np.float64]]] = {label: [] for label in others}
    rms: dict[str, list[tuple[float, float]]] = {label: [] for label in others}
    for number in range(passes):
        # A seed each: the random numbers of a role are the same in every method.
        for k, (label, estimator) in enumerate(estimators.items()):
            measured = estimator.step(number, seed + 1000 * k)
            sums[label] = measured if label not in sums else sums[label] + measured
            values = film.block_average(measured.mean("image") @ np.array(film.LUMINANCE), factor)
            if label == "path":
                own = values
            else:
                blocks[label].append(values - own)
        done = number + 1
        if done & number == 0 or done == passes:  # powers of two, and the end
            means = {label: measured.mean("image") for label, measured in sums.items()}
            for label in others:
                rms[label].append((float(done), film.luminance_rmse(means[label], means["path"])))
    plotting.save(out / f"correctness-{name}.svg", {f"{k} - path": v for k, v in rms.items()}, "Difference", "passes")
    where = f"{name}, {size[0]}x{size[1]}"
    return [_differences(where, rms, sums), _residual(where, blocks, factor)]


def _block(size: tuple[int, int]) -> int:
    """Side of a block of pixels that divides the picture."""
    return next(side for side in range(_BLOCK, 0, -1) if size[0] % side == 0 and size[1] % side == 0)


def _differences(where: str, rms: dict[str, list[tuple[float, float]]], sums: dict[str, Any]) -> Record:
    record = Record(f"Correctness: RMS of luminance, {where}", ("passes", *(f"{label} - path" for label in rms)))
    for rows in zip(*rms.values(), strict=True):
        record.add(f"{rows[0][0]:.0f}", *(f"{error:.5f}" for _, error in rows))
    slopes = []
    for points in rms.values():
        x, y = np.log(np.array(points)).T
        slopes.append(f"{np.polyfit(x, y, 1)[0]:.3f}" if len(x) > 1 else "none")
    record.add("slope", *slopes)
    bright = sums["path"].mean("image") @ np.array(film.LUMINANCE)
    record.notes += [
        "slope: of the logarithms, least squares; noise has -0.5, a bias that stays bends the curve to 0",
        f"mean luminance of the scene {bright.mean():.4f}; independent random numbers, one sample a pixel and pass",
        "vcm: radius 12 mm in the first pass, alpha 2/3, no merging at the first camera vertex",
        "thesis: RMS 0.006 between 3657 passes of PT and 929 of VCM",
    ]
    return record


def _residual(where: str, blocks: dict[str, list[NDArray[np.float64]]], side: int) -> Record:
    """Mean differences of blocks, each over its standard error: normal numbers if there is nothing but noise."""
    record = Record(
        f"Correctness: residual in blocks of {side}x{side}, {where}",
        ("", "blocks", "mean of z²", "largest |z|", f"|z| > {_OUTLIER:.2f}", "mean difference", "in standard errors"),
    )
    for label, passes in blocks.items():
        values = np.array(passes)
        count = len(values)
        error = np.maximum(values.std(axis=0, ddof=1), 1e-12) / np.sqrt(count) if count > 1 else np.inf
        z = values.mean(axis=0) / error
        overall = values.mean(axis=(1, 2))
        spread = overall.std(ddof=1) / np.sqrt(count) if count > 1 else np.inf
        record.add(
            f"{label} - path",
            str(z.size),
            f"{np.mean(z**2):.3f}",
            f"{np.abs(z).max():.2f}",
            f"{np.mean(np.abs(z) > _OUTLIER):.1%}",
            f"{overall.mean():+.2e}",
            f"{overall.mean() / spread:+.2f}",
        )
    count = len(next(iter(blocks.values())))
    expected = (count - 1) / (count - 3) if count > 3 else float("nan")
    record.notes.append(
        f"z: mean difference of a block's luminance over its standard error from {count} passes; without structure "
        f"the mean of z² is {expected:.3f} and {_EXPECTED:.0%} of |z| are above {_OUTLIER:.2f}"
    )
    return record
