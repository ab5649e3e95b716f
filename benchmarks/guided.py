"""Whether ``guided`` pays: its error times time beside that of Mitsuba's ``path`` and of ours, on indirect scenes."""

from __future__ import annotations

import gc
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from etendue import film, render, scene
from etendue.cli.options import parse_pairs

from .choice import scaled_size
from .measuring import Record, console, verdict
from .mitsuba_pictures import picture
from .options import Define, Names, Seconds, Seeds, Size
from .quality import Case, find

#: Error times time of ``guided``, relative to Mitsuba's ``path``, at most.
BAR = 1 / 3
SCENES = "veach-bidir,ajar"
#: Rows of a race, each a method of étendue and its settings, or "" for Mitsuba's ``path``; the name of that row.
Rows = Mapping[str, tuple[str, Mapping[str, Any]]]
MITSUBA = "Mitsuba path"
#: Share of the brightest errors that is left out: one firefly must not decide.
_TRIM = 0.001
#: Without a picture by somebody else: each half of the reference takes this many times the time of a picture.
_HALF = 4.0
#: Seconds after which a part of Mitsuba's picture shall be done.
_PART = 0.5


def measure(
    names: Names = SCENES,
    size: Size = "512x512",
    seconds: Seconds = 30.0,
    seeds: Seeds = 3,
    define: Define = None,
) -> Iterator[Record]:
    """One table a scene; the three take turns, seed by seed. ``define``: settings of ``guided``."""
    settings = parse_pairs(define, "-D")
    for name in names:
        case, own = referenced(name, size, seconds)
        if case is None:
            continue
        rows: Rows = {MITSUBA: ("", {}), "path": ("path", {}), "guided": ("guided", settings)}
        yield _record(case, race(case, own, rows, seconds, seeds), seconds, seeds, settings)


def race(case: Case, own: float, rows: Rows, seconds: float, seeds: int) -> dict[str, list[dict[str, float]]]:
    """What each row reaches, one entry a seed; they take turns. ``own``: error of the reference."""
    outcomes: dict[str, list[dict[str, float]]] = {row: [] for row in rows}
    for seed in range(seeds):
        for row, (method, settings) in rows.items():
            gc.collect()  # a scene that is still alive makes the next one's kernels larger
            image, samples, taken = (
                _timed(case, method, seconds, seed, settings)
                if method
                else picture(scene.load(case.source, size=case.size), seed, seconds=seconds, part_seconds=_PART)
            )
            error = max(film.relative_mse(image, case.reference, trim=_TRIM) - own, 0.0)
            outcomes[row].append(
                {
                    "plain": film.relative_mse(image, case.reference),
                    "trimmed": error,
                    "cost": error * taken,
                    "samples": samples,
                    "bias": film.relative_bias(image, case.reference),
                }
            )
            console.print(f"{case.name}, {row}, seed {seed}: {error:.4g} after {taken:.1f} s", style="dim")
    return outcomes


def _record(
    case: Case,
    outcomes: Mapping[str, Sequence[Mapping[str, float]]],
    seconds: float,
    seeds: int,
    settings: Mapping[str, Any],
) -> Record:
    record = Record(
        f"Guiding, {case.name}, {case.size[0]}x{case.size[1]}, {seconds:g} s",
        ("", "relMSE", "without worst 0.1 %", "that x s", "brightness", "spp", "to Mitsuba's path", "bar"),
    )
    plain = outcomes[MITSUBA]
    for method, runs in outcomes.items():
        middle = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
        ratio = statistics.median(run["cost"] / other["cost"] for run, other in zip(runs, plain, strict=True))
        record.add(
            method,
            f"{middle['plain']:.4g}",
            f"{middle['trimmed']:.4g}",
            f"{middle['cost']:.3g}",
            f"{middle['bias']:+.1%}",
            f"{middle['samples']:.0f}",
            f"{ratio:.3f}",
            verdict(ratio, BAR) if method == "guided" else "",
        )
    record.notes += [
        f"reference: {case.note}",
        f"median of {seeds} seed{'s' if seeds > 1 else ''}, the ratio too, seed by seed; one after the other in one "
        "process; the time begins when the scene is loaded, compilation included",
        "settings of guided: " + (", ".join(f"{k}={v}" for k, v in settings.items()) or "defaults"),
    ]
    return record


def referenced(
    name: str, size: tuple[int, int], seconds: float, by: str = "guided", source: Any = None
) -> tuple[Case | None, float]:
    """The scene with a reference, and the reference's own error. ``by``: the method of the reference of a bundled
    scene, or of another ``source``."""
    if source is not None or name in scene.bundled():
        source = source or name
        size = scaled_size(source, size[0] * size[1])
        first, second = (
            render(source, by, seconds=_HALF * seconds, size=size, seed=1000 + half).image for half in range(2)
        )
        mean = (first + second) / 2
        note = f"{by}, {2 * _HALF * seconds:g} s in two halves, whose difference tells its error"
        # Half of the halves' difference is as far from either as the mean is from the truth.
        return Case(name, source, mean, note), film.relative_mse(first, mean, trim=_TRIM)
    case = find(name, size)
    if isinstance(case, str):
        console.print(case)
        return None, 0.0
    return case, 0.0


def _timed(
    case: Case, method: str, seconds: float, seed: int, settings: Mapping[str, Any]
) -> tuple[np.ndarray, float, float]:
    """(picture, samples a pixel, seconds) of a run."""
    rendering = render(case.source, method, seconds=seconds, size=case.size, seed=seed, **settings)
    return rendering.image, float(rendering.metadata["samples"]), float(rendering.metadata["seconds"])
