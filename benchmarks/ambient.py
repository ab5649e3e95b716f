"""Paths that end in an ambient term beside whole paths and a constant ambient light, after the same time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue import film, render, scene

from . import plotting
from .measuring import PUBLIC_SCENES, Record, console
from .options import Names, Out, Pixels, ReferenceSeconds, Seconds, Seeds
from .racing import TRIM, Entrant, Image, marks, race
from .references import Recipe, Reference

SCENES = "cornell-box,ajar,grey-white-room"
OUT = Path("ambient-output")
#: What is fitted is the constant of this one.
_DIRECT = "direct light"
_CONSTANT = "direct light, constant ambient"
#: Passes of one sample, so that there are pictures early, too.
_PASS = {"samples_per_pass": 1}
_ENTRANTS = (
    Entrant("path", "path", _PASS),
    Entrant(_DIRECT, "path", {"max_depth": 2, "aovs": True} | _PASS),
    Entrant("ambient_path, classic, 1 bounce", "ambient_path", {"ambient": "classic"} | _PASS),
    Entrant("ambient_path, fuzzy, 1 bounce", "ambient_path", _PASS),
    Entrant("ambient_path, fuzzy, 2 bounces", "ambient_path", {"bounces": 2} | _PASS),
    Entrant("ambient_path, fuzzy, 4 bounces", "ambient_path", {"bounces": 4} | _PASS),
    Entrant("ambient_light, fuzzy, 2 bounces", "ambient_light", {"bounces": 2} | _PASS),
)
#: Of a scene whose light comes from another room.
_REFERENCES: dict[str, tuple[str, dict[str, Any]]] = {"ajar": ("bpt", {"guide_connections": True})}
Samples = Annotated[int, typer.Option("--albedo-samples", min=1, help="Of the picture of albedos for the constant.")]


def measure(
    scenes: Names = SCENES,
    pixels: Pixels = 32768,
    seconds: Seconds = 8.0,
    seeds: Seeds = 3,
    reference_seconds: ReferenceSeconds = 120.0,
    albedo_samples: Samples = 64,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        source = name if name in scene.bundled() else str(PUBLIC_SCENES / name / "scene.xml")
        if name not in scene.bundled() and not Path(source).is_file():
            console.print(f"{name}: left out, it is not here")
            continue
        width, height = scene.load(source).size
        factor = (pixels / (width * height)) ** 0.5
        size = max(round(width * factor), 8), max(round(height * factor), 8)
        method, settings = _REFERENCES.get(name, ("path", {}))
        recipe = Recipe(name, lambda source=source: source, method, settings)
        reference = recipe.find(size, out, reference_seconds)
        yield _scene(name, source, size, reference, seconds, seeds, albedo_samples, out)


def _scene(
    name: str,
    source: Any,
    size: tuple[int, int],
    reference: Reference,
    seconds: float,
    seeds: int,
    samples: int,
    out: Path,
) -> Record:
    problem, times = scene.load(source, size=size), marks(seconds, 7)
    albedo = render(source, "path", spp=samples, size=size, max_depth=1, aovs=True).layers["albedo"]
    fitted: dict[int, float] = {}

    def look(label: str, mark: int, image: Image) -> None:
        if label == _DIRECT:
            constant = fit(image, albedo, reference.image)
            fitted[mark] = film.luminance_rmse(image + constant * albedo, reference.image, TRIM)

    tracks = race(problem, _ENTRANTS, reference.image, times, range(seeds), look=look, clock=time.process_time)
    plotting.save(out / f"ambient-{name}.svg", {k: plotting.over_time(v) for k, v in tracks.items()}, name)
    record = Record(
        f"Ambient terms in pictures, {name}, {size[0]}x{size[1]}, {seconds:g} CPU s",
        ("", "spp", *(f"RMS at {mark:g} s" for mark in times)),
    )
    for label, points in tracks.items():
        record.add(label, f"{points[-1].samples:.0f}", *(point.text for point in points))
        if label == _DIRECT:
            # A pass may pass several marks at once.
            values = [
                fitted.get(k, min((v for j, v in fitted.items() if j >= k), default=np.nan)) for k in range(len(times))
            ]
            record.add(_CONSTANT, f"{points[-1].samples:.0f}", *(f"{value:.4f}" for value in values))
    mean = float(np.nanmean(reference.image))
    record.notes += [
        f"RMS of the difference of luminance, without the worst {TRIM:.1%} of the pixels; the mean of the picture is "
        f"{mean:.3g}; reference: {reference.note}",
        "the constant, a colour times the albedo of what is seen, is the best there is: fitted to the reference",
        f"mean squares of {seeds} seeds with standard errors (the constant: of one); in turn, pass by pass; CPU "
        "time of passes over all threads, without loading, compilation and preparation",
    ]
    return record


def fit(image: Image, albedo: Image, reference: Image) -> Image:
    """The colour that, times the albedo, is missing in a picture, by least squares."""
    good = np.isfinite(reference).all(axis=2)
    a, missing = albedo[good].astype(np.float64), (reference - image)[good].astype(np.float64)
    return np.maximum((a * missing).sum(axis=0) / np.maximum((a * a).sum(axis=0), 1e-12), 0).astype(np.float32)
