"""Chains on the film are drawn to lights that the camera sees: what each cure of ``film_metropolis`` does about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from etendue import film, methods, render
from etendue.core import Measurement, OptionError, Replica
from etendue.methods import FilmMetropolis
from etendue.scene import bundled_scene, load

from ..measuring import Record
from ..options import Names, Out, ReferenceSeconds, Seeds, Size

Array = NDArray[Any]
#: Scenes whose lights the camera sees.
SCENES = "cornell-box,cornell-glass,street"
#: Settings of ``film_metropolis`` by cure: what is done with lights that are seen, and a target over the brightness.
CURES: dict[str, dict[str, Any]] = {
    "none": {"lights": "chain"},
    "split": {"lights": "split"},
    "later": {"lights": "later"},
    "equalised": {"lights": "chain", "equalise": True},
    "split, equalised": {"lights": "split", "equalise": True},
    "later, equalised": {"lights": "later", "equalise": True},
}
#: Steps per pixel of a pass, and paths of a pixel that tell where lights are seen.
_PER_PASS, _PILOT = 64, 64
_REFERENCE_SEEDS = (7001, 7002)


@dataclass(frozen=True)
class _Errors:
    """Of one picture. rms: of luminance, over its mean; dim, shown: relMSE and rms of the picture as it is displayed,
    without lights; there: share of the samples at lights; rays: of a step."""

    rms: float
    relative: float
    shown: float
    dim: float
    there: float
    rays: float


def measure(
    scenes: Names = SCENES,
    size: Size = "64x64",
    steps: Annotated[int, typer.Option(min=_PER_PASS, help="Steps of the chains per pixel.")] = 512,
    seeds: Seeds = 3,
    reference_seconds: ReferenceSeconds = 20.0,
    out: Out = Path("metropolis-output"),
) -> Iterator[Record]:
    """A table of each scene: errors after equally many steps, by cure, and by ``path`` with as many camera paths."""
    for name in scenes:
        problem = load(boxed(name), size=size)
        halves = reference_of(name, size, reference_seconds, out)
        lights = _lights(name, size)
        if not lights.any() or lights.all():
            raise OptionError(f"the camera must see lights in a part of the picture, but not so in '{name}'")
        passes = max(1, steps // _PER_PASS)
        found = {
            label: [_run(problem, "film_metropolis", own, seed, passes, halves, lights) for seed in range(seeds)]
            for label, own in CURES.items()
        }
        found["path"] = [_run(problem, "path", {}, seed, passes, halves, lights) for seed in range(seeds)]
        yield _record(name, found, size, passes * _PER_PASS, halves, lights)


def boxed(name: str) -> dict[str, Any]:
    """A bundled scene with the box filter, which a histogram of samples is."""
    scene = bundled_scene(name).build()
    scene["sensor"]["film"]["rfilter"] = {"type": "box"}
    return scene


def reference_of(name: str, size: tuple[int, int], seconds: float, out: Path) -> Array:
    """Two independent pictures by ``bpt``, (2, height, width, 3), kept in a file."""
    path = out / f"cures-{name}-{size[0]}x{size[1]}.npy"
    if not path.exists():
        out.mkdir(parents=True, exist_ok=True)
        halves = [
            render(boxed(name), "bpt", seed=seed, size=size, seconds=seconds / 2).image for seed in _REFERENCE_SEEDS
        ]
        np.save(path, np.stack(halves))
    made: Array = np.load(path)
    return made


def _lights(name: str, size: tuple[int, int]) -> Array:
    """Pixels in or next to which lights are seen, (height, width)."""
    seen = render(boxed(name), "path", size=size, spp=_PILOT, max_depth=1).image.sum(axis=2) > 0.0
    height, width = seen.shape
    padded = np.pad(seen, 1)
    return np.any([padded[i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=0)


def _run(
    problem: Any, method: str, own: dict[str, Any], seed: int, passes: int, halves: Array, lights: Array
) -> _Errors:
    kind = methods.get(method)
    made: Any = kind(kind.Settings(**{"max_depth": problem.max_depth, "samples_per_pass": _PER_PASS} | own))
    made.prepare(problem, seed)
    replica = Replica(made, seed)
    total = replica.step(0)
    for number in range(1, passes):
        total = total + replica.step(number)
    picture, reference = total.mean("image"), halves.mean(axis=0)
    brightness = float((reference @ np.array(film.LUMINANCE)).mean())
    relative = film.relative_squared_error(picture, reference)
    return _Errors(
        rms=film.luminance_rmse(picture, reference) / brightness,
        relative=float(relative.mean()),
        shown=film.luminance_rmse(_displayed(picture), _displayed(reference)),
        dim=float(relative[~lights].mean()),
        there=_share(total, lights) if method == FilmMetropolis.name else float("nan"),
        rays=total.counters["rays"],
    )


def _displayed(picture: Array) -> Array:
    """What a display shows: values up to 1, in steps that look even."""
    shown: Array = np.clip(picture, 0.0, 1.0) ** (1 / 2.2)
    return shown


def _share(total: Measurement, lights: Array) -> float:
    """Share of the samples on the film that lie on the pixels of ``lights``."""
    height, width = lights.shape
    inside = there = 0
    for rows in total.records["film"]:
        column, row = np.floor(rows[:, 0] * width).astype(int), np.floor(rows[:, 1] * height).astype(int)
        kept = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        inside += int(kept.sum())
        there += int(lights[row[kept], column[kept]].sum())
    return there / max(inside, 1)


def _record(
    name: str, found: dict[str, list[_Errors]], size: tuple[int, int], steps: int, halves: Array, lights: Array
) -> Record:
    record = Record(
        f"Cures of light attraction, {name}, {size[0]}x{size[1]}, {steps} steps a pixel",
        ("", "RMS", "RMS displayed", "relMSE", "relMSE without lights", "samples at lights", "rays"),
    )
    first = np.mean([run.rays for run in found["none"]])
    for label, runs in found.items():
        shares = float(np.mean([run.there for run in runs]))
        record.add(
            label,
            _text([run.rms for run in runs]),
            _text([run.shown for run in runs]),
            _text([run.relative for run in runs]),
            _text([run.dim for run in runs]),
            "" if np.isnan(shares) else f"{shares:.1%}",
            f"{np.mean([run.rays for run in runs]) / first:.2f}",
        )
    reference = halves.mean(axis=0)
    own = film.relative_squared_error(halves[0], reference)
    shown = film.luminance_rmse(_displayed(halves[0]), _displayed(reference))
    light = float(reference[lights].sum() / reference.sum())
    record.notes += [
        f"means of {len(found['none'])} seeds and their standard errors; RMS of luminance over its mean; displayed: "
        "values up to 1 to the power of 1/2.2; rays relative to the first row",
        f"lights: the {lights.mean():.1%} of the pixels in or next to which one is seen, with {light:.0%} of the light",
        f"reference: bpt in two halves; its own relMSE {own.mean():.2g}, without lights {own[~lights].mean():.2g}, RMS "
        f"displayed {shown:.2g}; path: as many camera paths as steps",
    ]
    return record


def _text(values: list[float]) -> str:
    error = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return f"{np.mean(values):.4g} ± {error:.1g}"
