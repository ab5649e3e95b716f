"""Film Metropolis by the size of its small steps, and by the paths that its chains mutate (E5, figure 6.23 and section
5.7.6 of Leeson's thesis)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from unittest.mock import patch

import drjit as dr
import numpy as np
import typer
from numpy.typing import NDArray

from etendue import film
from etendue.core import Replica
from etendue.integration import primary
from etendue.methods import FilmMetropolis
from etendue.scene import Problem, load

from ..measuring import Record
from ..options import Names, Out, ReferenceSeconds, Seeds, Size
from .cures import boxed, reference_of

SIZES = (0.005, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
#: Small steps by label: whether their distance is uniform up to the size, as in the thesis, or its logarithm, and the
#: share of large steps: few, as the chains of the thesis have none; and tuned.
KINDS = {"uniform, 2 % large": (True, 0.02), "log-uniform, large tuned": (False, 0.0)}
#: Strategies of section 5.7.6 by the setting ``paths``.
PATHS = ("light", "camera", "bidirectional")
_PER_PASS = 32
Steps = Annotated[int, typer.Option(min=_PER_PASS, help="Steps of the chains per pixel.")]


@dataclass(frozen=True)
class _Run:
    """relative: relMSE; rms: of luminance, over its mean; both without the worst 0.1 % of the pixels."""

    relative: float
    rms: float
    accepted: float  #: of small steps
    cpu: float  #: seconds of the passes
    rays: float


def measure(
    scenes: Names = "glass-of-water",
    size: Size = "64x48",
    steps: Steps = 256,
    seeds: Seeds = 4,
    paths: Annotated[str, typer.Option(help="Paths that the chains mutate.")] = "camera",
    reference_seconds: ReferenceSeconds = 60.0,
    out: Out = Path("metropolis-output"),
) -> Iterator[Record]:
    """A table of each scene: errors after equally many steps, by their size, as in the thesis and as ours."""
    for name in scenes:
        problem, halves = load(boxed(name), size=size), reference_of(name, size, reference_seconds, out)
        record = Record(
            f"Steps of film Metropolis, {name}, paths={paths}, {size[0]}x{size[1]}, {steps} steps a pixel",
            ("distances", "step size", "RMS", "relMSE", "small steps accepted"),
        )
        for label, (uniform, share) in KINDS.items():
            for step in (*SIZES, 0.0):
                own = {"paths": paths, "large_steps": share, "step_size": step}
                with patch.object(primary, "moved", _moved) if uniform else nullcontext():
                    runs = [_run(problem, own, seed, steps, halves) for seed in range(seeds)]
                accepted = f"{np.mean([run.accepted for run in runs]):.0%}"
                record.add(label, f"{step:g}" if step else "tuned", *_errors(runs), accepted)
        record.notes += _notes(halves, seeds)
        yield record


def strategies(
    scenes: Names = "glass-of-water,cornell-box,cornell-glass",
    size: Size = "64x48",
    steps: Steps = 128,
    seeds: Seeds = 4,
    reference_seconds: ReferenceSeconds = 60.0,
    out: Out = Path("metropolis-output"),
) -> Iterator[Record]:
    """A table of each scene: errors of chains over light paths, camera paths and pairs of both."""
    for name in scenes:
        problem, halves = load(boxed(name), size=size), reference_of(name, size, reference_seconds, out)
        record = Record(
            f"Paths of film Metropolis, {name}, {size[0]}x{size[1]}, {steps} steps a pixel",
            ("paths", "RMS", "relMSE", "rays", "CPU s", "relMSE times CPU, to camera"),
        )
        found: dict[str, list[_Run]] = {name: [] for name in PATHS}
        for seed in range(-1, seeds):  # interleaved; the first round compiles
            for paths, runs in found.items():
                runs.append(_run(problem, {"paths": paths}, max(seed, 0), steps if seed >= 0 else _PER_PASS, halves))
        found = {paths: runs[1:] for paths, runs in found.items()}
        plain = found["camera"]
        for paths, runs in found.items():
            equal = [a.relative * a.cpu / (b.relative * b.cpu) for a, b in zip(runs, plain, strict=True)]
            rays, cpu = (np.mean([getattr(run, field) for run in runs]) for field in ("rays", "cpu"))
            record.add(paths, *_errors(runs), f"{1e-6 * rays:.1f} M", f"{cpu:.1f}", _text(equal, 3))
        record.notes += [*_notes(halves, seeds), "what light paths cannot render, such as mirrors, counts as error"]
        yield record


def _moved(x: dr.ArrayBase, u: dr.ArrayBase, size: dr.ArrayBase | float) -> dr.ArrayBase:
    """:func:`etendue.integration.primary.moved` with a distance that is uniform up to ``size``."""
    y = x + (2.0 * u - 1.0) * size
    return dr.minimum(y - dr.floor(y), 1.0 - 2.0**-24)


def _run(problem: Problem, own: dict[str, Any], seed: int, steps: int, halves: NDArray[Any]) -> _Run:
    settings = {"max_depth": problem.max_depth, "samples_per_pass": _PER_PASS} | own
    method = FilmMetropolis(FilmMetropolis.Settings(**settings))
    method.prepare(problem, seed)
    replica, begin = Replica(method, seed), time.process_time()
    total = replica.step(0)
    for number in range(1, max(1, steps // _PER_PASS)):
        total = total + replica.step(number)
    cpu = time.process_time() - begin
    picture, reference = total.mean("image"), halves.mean(axis=0)
    relative = np.sort(film.relative_squared_error(picture, reference).ravel())
    brightness = float((reference @ np.array(film.LUMINANCE)).mean())
    return _Run(
        float(relative[: round(0.999 * len(relative))].mean()),
        film.luminance_rmse(picture, reference, 0.001) / brightness,
        method.facts(total, replica.state)["accepted_small"],
        cpu,
        total.counters["rays"],
    )


def _errors(runs: Sequence[_Run]) -> list[str]:
    return [_text([getattr(run, field) for run in runs]) for field in ("rms", "relative")]


def _text(values: Sequence[float], digits: int = 4) -> str:
    error = np.std(values, ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan
    return f"{np.mean(values):.{digits}g} ± {error:.1g}"


def _notes(halves: NDArray[Any], seeds: int) -> list[str]:
    own = film.relative_squared_error(halves[0], halves.mean(axis=0)).mean()
    return [
        f"means of {seeds} seeds and their standard errors, without the worst 0.1 % of the pixels; RMS of luminance, "
        f"over its mean; reference: bpt in two halves, its own relMSE {own:.2g}; lights that are seen are painted later"
    ]
