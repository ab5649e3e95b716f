"""Long renderings that the errors are measured against, kept as OpenEXR files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from etendue import film
from etendue.api import render
from etendue.core import Result

from ..measuring import console
from .racing import TRIM, Image
from .scenes import SCENES

#: VCM with the radius of the thesis's sweep that blurs least, our other settings and other seeds than the experiments;
#: path tracing where everything is matt: it is unbiased, and best there.
_MERGING = {"radius": 0.005, "radius_unit": "absolute"}
_SEEDS = (7001, 7002)
#: Pixels of a reference that are brighter than so many times its mean see a lamp, directly, in a mirror or through
#: glass. They are left out of every error: how the edge of a lamp falls on the pixels would drown all else.
WHITE = 10.0


@dataclass(frozen=True)
class Reference:
    """A reference picture."""

    image: Image  #: not a number where it sees a lamp
    noise: float  #: RMS of luminance that is its own, estimated from its two halves
    note: str  #: how it was made


def find(scene: str, size: tuple[int, int], folder: Path, seconds: float) -> Reference:
    """The reference of a scene at a size, from its file in ``folder``; made in ``seconds`` if that does not exist."""
    path = folder / f"reference-{scene}-{size[0]}x{size[1]}.exr"
    return _read(path) if path.is_file() else make(scene, size, folder, seconds)


def make(scene: str, size: tuple[int, int], folder: Path, seconds: float) -> Reference:
    """Render a reference in two halves by two seeds, and keep it in ``folder``."""
    method = "path" if scene == "diffuse" else "vcm"
    console.print(f"reference of {scene}, {size[0]}x{size[1]}, by {method}, {seconds:g} s", style="dim")
    settings = {} if method == "path" else _MERGING
    halves = [render(SCENES[scene](), method, seconds=seconds / 2, size=size, seed=s, **settings) for s in _SEEDS]
    first, second = (half.image for half in halves)
    samples = sum(half.metadata["samples"] for half in halves)
    note = f"{method}, {samples} samples a pixel in {seconds:g} s" + (", first radius 5 mm" if settings else "")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"reference-{scene}-{size[0]}x{size[1]}.exr"
    mean, noise = np.float32(0.5) * (first + second), np.float32(0.5) * (first - second)
    film.write_exr(path, Result({"image": mean, "noise": noise}, halves[0].metadata | {"note": note}))
    return _read(path)


def _read(path: Path) -> Reference:
    result = film.read_exr(path)
    image, noise = result.image.copy(), result.layers["noise"]
    luminance = image @ np.array(film.LUMINANCE)
    lamps = luminance > WHITE * luminance.mean()
    image[lamps] = np.nan
    own = film.luminance_rmse(image + noise, image, TRIM)
    note = f"{result.metadata['note']}; its own noise {own:.4f}; {lamps.mean():.2%} of the pixels see a lamp, left out"
    return Reference(image, own, note)
