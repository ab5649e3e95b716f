"""Ambient terms (chapter 6 of the thesis): what they bring at once, and what they add to solvers that stop early."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.display import tonemap, write_png
from etendue.points import OwenSobol
from etendue.products.patches import picture
from etendue.radiosity import (
    AMBIENT_TERMS,
    ABuffer,
    AmbientTerm,
    FirstShot,
    FormFactors,
    Patches,
    RadiosityError,
    RayScene,
    Segments,
    Solution,
    Solver,
    SpherePairs,
    ambient_solution,
    finished,
    form_factors,
    multipath,
    multipath_bundles,
    shot_at_patches,
    solve,
    sub_scenes,
)
from etendue.surfaces import class_light, class_weights

from ..measuring import Record, console, interleaved, spread
from ..options import Out, Rounds, Seeds, Size, scene_names
from .ambient_scenes import AMBIENT_SCENES, Shown
from .drivers import DRIVERS, INDEPENDENT
from .options import OUT, Detail, ReferenceBundles
from .scenes import SCENES
from .sweeping import WholeRays

Pictures = Annotated[bool, typer.Option("--pictures/--no-pictures", help="Pictures of each scene in --out.")]
AmbientScenes = scene_names(AMBIENT_SCENES)
Scenes = scene_names(SCENES)
_EVERY = ",".join(AMBIENT_SCENES)
#: Rays of the first shot.
_RAYS = 1 << 20
#: Of the patches for the table of times.
DETAILS = (1.0, 3.4, 10.7)
#: Seconds of the thesis for pictures, rendering included, on a Pentium II of 350 MHz.
_THESIS = {
    "interior": "6.4: 0.24 and 0.29 s",
    "bleed-box": "6.5: +0.05 s",
    "curved": "6.6: 0.23 (crisp) and 0.24 s (fuzzy)",
    "curved-colour": "6.7: 0.27 and 0.31 s",
    "three-lamps": "6.8: no extra cost",
}


def measure(
    scenes: AmbientScenes = _EVERY,
    detail: Detail = 1.0,
    bundles: ReferenceBundles = 2048,
    size: Size = "240x200",
    pictures: Pictures = True,
    rounds: Rounds = 11,
    out: Out = OUT,
) -> Iterator[Record]:
    """E13: error and time of every term; and the time of many patches."""
    record = Record(
        "Ambient terms: RMS error of the irradiance, relative to that of a solution by lines",
        (
            *("", "patches", "term", "all light", "by 1/5 between classes", "after direct light by rays", "the same"),
            "CPU ms",
            "thesis, figure",
        ),
    )
    for name in scenes:
        shown = AMBIENT_SCENES[name](detail)
        _rows(record, name, shown, bundles, rounds, size if pictures else None, out)
    record.notes += [
        "all light: emission is spread; after direct light: what is reflected of the light that a shot of "
        f"{_RAYS} rays has brought. 1/5: class form factors of the thesis; the others are reciprocal",
        f"reference: {bundles} bundles of lines after a shot of as many rays",
        f"CPU ms: all light, without the shot; median of {rounds} rounds in turn",
    ]
    yield record
    if "bleed-box" in scenes:
        yield _bleeding(AMBIENT_SCENES["bleed-box"](detail).patches, bundles)
    yield _speed(rounds)


def _rows(
    record: Record, name: str, shown: Shown, bundles: int, rounds: int, size: tuple[int, int] | None, out: Path
) -> None:
    patches = shown.patches
    shot = shot_at_patches(RayScene(patches), _RAYS)
    exact = solve(patches, ABuffer(patches).cast(bundles), "conjugate-gradient", shot=shot)
    parts = None if shown.parts is None else sub_scenes(patches, shown.parts)
    tasks: dict[str, Callable[..., Solution]] = {
        str(term): lambda shot=None, term=term: ambient_solution(patches, term, shot=shot) for term in AMBIENT_TERMS
    }
    if parts is not None:
        tasks["fuzzy, sub-scenes"] = lambda shot=None: ambient_solution(patches, "fuzzy", parts, shot)
    clocks = interleaved({key: lambda _, task=task: task() for key, task in tasks.items()}, rounds, 1)

    def error(irradiance: Array) -> str:
        return f"{_relative(patches, irradiance, exact.irradiance):.3f}"

    for key, task in tasks.items():
        plain = ("", "")
        if key in ("crisp", "fuzzy"):
            emitted, reflected = patches.areas[:, None] * patches.emission, shot.reflected
            plain = (
                error(_by_fifths(patches, key, emitted)),
                error(shot.irradiance + _by_fifths(patches, key, reflected)),
            )
        milliseconds = spread([1000 * clock.cpu for clock in clocks[key]], ".1f")
        cells = error(task().irradiance), plain[0], error(task(shot).irradiance), plain[1], milliseconds
        record.add(name, str(len(patches)), key, *cells, _THESIS[name] if key == "classic" else "")
    if size is not None:
        made = [task() for task in tasks.values()] + [task(shot) for task in tasks.values()] + [exact]
        _strip(out / f"ambient-{name}.png", shown, made, size)


def _bleeding(patches: Patches, bundles: int) -> Record:
    """Colours of the white cube."""
    shot = shot_at_patches(RayScene(patches), _RAYS)
    solutions = {
        **{f"{term}, after direct light": ambient_solution(patches, term, shot=shot) for term in AMBIENT_TERMS},
        "by lines": solve(patches, ABuffer(patches).cast(bundles), "conjugate-gradient", shot=shot),
    }
    middle = sum(patches.bounds) / 2
    cube = np.abs(patches.centres - middle).max(axis=1) < 0.51
    record = Record("Red over green on the white cube of bleed-box", ("", "towards red", "towards green", "the front"))
    for label, solution in solutions.items():
        ratios = []
        for direction in ((-1, 0, 0), (1, 0, 0), (0, -1, 0)):
            side = cube & (patches.normals @ direction > 0.9)
            light = patches.areas[side] @ solution.radiosity[side]
            ratios.append(f"{light[0] / light[1]:.2f}")
        record.add(label, *ratios)
    return record


def _by_fifths(patches: Patches, term: AmbientTerm | str, power: Array) -> Array:
    weights = class_weights(term, patches.normals)  # type: ignore[arg-type]
    light = class_light(weights, patches.areas, patches.reflectance, power, factors=equal_factors)
    return weights @ light


def _relative(patches: Patches, found: Array, exact: Array) -> float:
    areas = patches.areas[:, None]
    return float(np.sqrt((areas * (found - exact) ** 2).sum() / (areas * exact**2).sum()))


def _strip(path: Path, shown: Shown, solutions: list[Solution], size: tuple[int, int]) -> None:
    """Pictures side by side, with the exposure of the last."""
    scene = shown.mitsuba(size)
    images = [picture(solution, scene, spp=64).image for solution in solutions]
    white = np.percentile(images[-1].mean(axis=2), 97) / 0.9
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.concatenate([tonemap(image / white) for image in images], axis=1))
    console.print(f"pictures: {path}", style="dim")


def _speed(rounds: int) -> Record:
    """Time of the terms on many patches, beside a solution by few lines."""
    record = Record(
        "Ambient terms of many patches, CPU ms", ("patches", *AMBIENT_TERMS, "one product with 64 bundles of lines")
    )
    for detail in DETAILS:
        patches = SCENES["room"](detail)
        segments = ABuffer(patches).cast(64)
        values = np.ones((len(patches), 3))
        tasks: dict[str, Callable[[int], Any]] = {
            str(term): lambda _, patches=patches, term=term: ambient_solution(patches, term) for term in AMBIENT_TERMS
        }
        tasks["gather"] = lambda _, segments=segments, values=values: segments.gather(values)
        clocks = interleaved(tasks, rounds, 2)
        record.add(str(len(patches)), *(spread([1000 * c.cpu for c in found], ".1f") for found in clocks.values()))
    record.notes.append(
        f"room; median of {rounds} rounds in turn, over all threads; normals and areas are known before"
    )
    return record


# ---------------------------------------------------------------------------------------------------- finishing


def finishing(
    scenes: Scenes = "six-cubes,room",
    detail: Detail = 1.0,
    bundles: ReferenceBundles = 1024,
    seeds: Seeds = 10,
) -> Iterator[Record]:
    """What is left of solvers that stop early, with and without an ambient term."""
    for name in scenes:
        patches = SCENES[name](detail)
        segments = ABuffer(patches).cast(bundles)
        shot = shot_at_patches(RayScene(patches), _RAYS)
        record = Record(
            f"Solvers that stop early, {name}, {len(patches)} patches: relative RMS error of the irradiance",
            ("", "stops after", "left out", *AMBIENT_TERMS, "left out, to fuzzy"),
        )
        _solvers(record, patches, segments, shot)
        _multipath(record, patches, segments, shot, seeds)
        record.notes += [
            "solvers: of the system that a shot has left, against its converged solution; an iteration of southwell is "
            "as many shots as there are patches",
            f"multipath: radiosity, against the solution; mean square of {seeds} seeds, with its standard error; noise "
            "of the lines included",
        ]
        yield record


def _solvers(record: Record, patches: Patches, segments: Segments, shot: FirstShot) -> None:
    factors = form_factors(segments)
    exact = solve(patches, factors, "direct", shot=shot).irradiance
    for solver, iterations in (("jacobi", (1, 2, 3, 5)), ("conjugate-gradient", (1, 2, 3)), ("southwell", (1, 2))):
        for count in iterations:
            errors = [
                _relative(patches, _stopped(patches, factors, solver, shot, count, term), exact)  # type: ignore[arg-type]
                for term in (None, *AMBIENT_TERMS)
            ]
            cells = (f"{error:.4f}" for error in errors)
            record.add(solver, f"{count} iteration{'s' if count > 1 else ''}", *cells, f"{errors[0] / errors[-1]:.1f}")


def _stopped(
    patches: Patches, factors: FormFactors, solver: Solver, shot: FirstShot, count: int, term: AmbientTerm | None
) -> Array:
    """Irradiance after ``count`` iterations. Without a term from what the solver complains of: it has not converged, so
    the same iterations are asked for by a tolerance that the last of them meets."""
    if term is not None:
        return solve(patches, factors, solver, shot=shot, max_iterations=count, ambient=term).irradiance
    done = solve(patches, factors, solver, shot=shot, max_iterations=count, ambient="classic").residuals
    try:
        return solve(patches, factors, solver, shot=shot, tolerance=done[-1], max_iterations=count).irradiance
    except RadiosityError:  # an earlier iteration had met it
        return np.full_like(shot.irradiance, np.nan)


def _multipath(record: Record, patches: Patches, segments: Segments, shot: FirstShot, seeds: int) -> None:
    exact = solve(patches, segments, "conjugate-gradient", shot=shot).radiosity
    scene = RayScene(patches)

    def by_lines(count: int, seed: int) -> Any:
        return multipath(WholeRays(SpherePairs(patches), scene, DRIVERS[INDEPENDENT](count, seed)), count, shot=shot)

    def by_bundles(rounds: int) -> Callable[[int, int], Any]:
        return lambda count, seed: multipath_bundles(
            ABuffer(patches, OwenSobol(4, seed=seed)), count, shot=shot, rounds=rounds
        )

    for label, after, run, count in (
        ("multipath", "1024 lines", by_lines, 1 << 10),
        ("multipath", "16384 lines", by_lines, 1 << 14),
        ("multipath by bundles", "64 bundles, one round", by_bundles(1), 64),
        ("multipath by bundles", "64 bundles, until all is sent", by_bundles(4), 64),
    ):
        squares = np.empty((seeds, 4))
        for seed in range(seeds):
            found = run(count, seed)
            every = [found, *(finished(patches, found, term) for term in AMBIENT_TERMS)]
            squares[seed] = [_relative(patches, each.radiosity, exact) ** 2 for each in every]
        mean = np.sqrt(squares.mean(axis=0))
        error = squares.std(axis=0, ddof=1) / np.sqrt(seeds) / (2 * mean) if seeds > 1 else np.full(4, np.nan)
        cells = (f"{value:.4f} ± {own:.4f}" for value, own in zip(mean, error, strict=True))
        record.add(label, after, *cells, f"{mean[0] / mean[-1]:.1f}")


def equal_factors(areas: Array) -> Array:
    """Class form factors of the thesis: 1/5 between any two of six classes, whatever their ``areas`` (k,)."""
    count = len(areas)
    return np.ones((1, 1)) if count == 1 else (1 - np.eye(count)) / (count - 1)
