"""The demonstration of the sine (figures 5.19 to 5.31 of the thesis): what smoothing and damping do to VEGAS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.integration import AxisBins, Integrand, Vegas, library

from .. import plotting
from ..measuring import Record
from ..options import Out, Seeds, whole_numbers
from .options import OUT

BINS = 10
SINE = Integrand(lambda x: library(x[0]).sin(x[0]), [(0.0, math.pi)])


@dataclass(frozen=True)
class Stabiliser:
    """What keeps bins from jumping; ``off``: until half of the iterations are done."""

    smoothing: bool = False
    damping: float | None = None
    off: bool = False


STABILISERS = {
    "raw": Stabiliser(),
    "smoothed": Stabiliser(smoothing=True),
    "damped": Stabiliser(damping=1.5),
    "both": Stabiliser(smoothing=True, damping=1.5),
    "both, then off": Stabiliser(smoothing=True, damping=1.5, off=True),
}


def variance(edges: Array, mode: str) -> float:
    """N times the variance of an estimate from N samples in the bins between ``edges`` of [0, 1], by quadrature."""
    points = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(200) + 0.5) / 200
    w = np.sin(points * math.pi) * np.diff(edges)[:, None] * math.pi * (len(edges) - 1)
    return float(w.var(axis=1).mean() if mode == "stratified" else w.var())


def learned(mode: str, how: Stabiliser, samples: int, iterations: int, seed: int) -> list[Array]:
    """The borders that each iteration draws from, as ``samples`` in each of those before have left them."""
    density, borders = None, [AxisBins.even(BINS).edges]
    for number in range(iterations - 1):
        steady = how.off and number >= iterations // 2
        integrator = Vegas(
            mode=mode,
            iterations=1,
            bins=BINS,
            strata=BINS if mode == "stratified" else 1,
            smoothing=how.smoothing and not steady,
            damping=None if steady else how.damping,
            stabilise=0 if steady else None,
            density=density,
        )
        density = integrator.integrate(SINE, samples, seed=seed * iterations + number).details["density"]
        borders.append(density.factors[0].edges)
    return borders


def measure(
    counts: Annotated[
        Any,
        typer.Option("--samples", parser=whole_numbers, help="Of an iteration, separated by commas.", metavar="N,..."),
    ] = "100,1000,10000,100000",
    iterations: Annotated[int, typer.Option(min=2, help="The bins of the last one are judged.")] = 5,
    seeds: Seeds = 40,
    out: Out = OUT,
) -> list[Record]:
    """A table and a plot for each mode: the variance of the last iteration's bins over the samples of an iteration."""
    records = []
    for mode in ("importance", "stratified"):
        record = Record(
            f"Sine, {mode} mode: N times the variance of iteration {iterations}",
            ("", *(f"N = {count}" for count in counts), f"borders move, N = {counts[0]}"),
        )
        even = AxisBins.even(BINS).edges
        record.add("even bins", *[f"{variance(even, mode):.4f}"] * len(counts), "0")
        curves = {"even bins": [_error(count, variance(even, mode)) for count in counts]}
        for name, how in STABILISERS.items():
            found = [[learned(mode, how, n, iterations, seed) for seed in range(seeds)] for n in counts]
            means = [float(np.mean([variance(b[-1], mode) for b in runs])) for runs in found]
            moved = np.mean([np.abs(b[-1] - b[-2]).mean() for b in found[0]])
            record.add(name, *(f"{mean:.4f}" for mean in means), f"{moved:.4f}")
            curves[name] = [_error(n, mean) for n, mean in zip(counts, means, strict=True)]
        record.notes += [
            f"integral of sin over [0, pi], {BINS} bins, N samples an iteration, mean of {seeds} seeds; damping 1.5",
            "'both, then off': neither in the second half of the iterations, where borders go by contributions, not by "
            "their squares",
            "borders move: mean way of a border from the last iteration but one to the last, of an interval of 1",
        ]
        title = f"Sine, {mode} mode, iteration {iterations}"
        plotting.save(out / f"sine-{mode}.svg", curves, title, "samples an iteration", "standard error")
        records.append(record)
    return records


def _error(samples: int, variance: float) -> tuple[float, float]:
    """(samples, standard error of the mean of so many)."""
    return float(samples), math.sqrt(variance / samples)
