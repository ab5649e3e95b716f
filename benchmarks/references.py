"""Long renderings that errors are measured against, kept as OpenEXR files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from etendue import film, render
from etendue.core import Result

from .measuring import Record, console
from .racing import TRIM, Image

#: Other seeds than those of the experiments, one for each half.
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


@dataclass(frozen=True)
class Recipe:
    """How the reference of a scene is made."""

    name: str
    build: Callable[[], Any]
    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    remark: str = ""
    mark: str = ""  #: in the file's name, where a scene has references of several kinds

    def find(self, size: tuple[int, int], folder: Path, seconds: float) -> Reference:
        """From its file in ``folder``; made in ``seconds`` if that does not exist."""
        path = self._path(size, folder)
        return _read(path) if path.is_file() else self.make(size, folder, seconds)

    def make(self, size: tuple[int, int], folder: Path, seconds: float) -> Reference:
        """Render in two halves by two seeds, and keep it in ``folder``."""
        console.print(f"reference of {self.name}, {size[0]}x{size[1]}, by {self.method}, {seconds:g} s", style="dim")
        options: Any = {"size": size, "seconds": seconds / 2, **self.settings}
        halves = [render(self.build(), self.method, seed=seed, **options) for seed in _SEEDS]
        first, second = (half.image for half in halves)
        samples = sum(half.metadata["samples"] for half in halves)
        note = f"{self.method}, {samples} samples a pixel in {seconds:g} s{self.remark}"
        folder.mkdir(parents=True, exist_ok=True)
        path = self._path(size, folder)
        mean, noise = np.float32(0.5) * (first + second), np.float32(0.5) * (first - second)
        film.write_exr(path, Result({"image": mean, "noise": noise}, halves[0].metadata | {"note": note}))
        return _read(path)

    def _path(self, size: tuple[int, int], folder: Path) -> Path:
        mark = f"-{self.mark}" if self.mark else ""
        return folder / f"reference-{self.name}{mark}-{size[0]}x{size[1]}.exr"


def remade(recipes: Sequence[tuple[Recipe, tuple[int, int]]], seconds: float, folder: Path) -> Record:
    """References made anew, whatever there is of them, and their noise."""
    record = Record(f"References, {seconds:g} s", ("", "noise (RMS of luminance)", "made by"))
    for recipe, size in recipes:
        made = recipe.make(size, folder, seconds)
        record.add(f"{recipe.name}, {size[0]}x{size[1]}", f"{made.noise:.5f}", made.note)
    return record


def _read(path: Path) -> Reference:
    result = film.read_exr(path)
    image, noise = result.image.copy(), result.layers["noise"]
    luminance = image @ np.array(film.LUMINANCE)
    lamps = luminance > WHITE * luminance.mean()
    image[lamps] = np.nan
    own = film.luminance_rmse(image + noise, image, TRIM)
    note = f"{result.metadata['note']}; its own noise {own:.4f}; {lamps.mean():.2%} of the pixels see a lamp, left out"
    return Reference(image, own, note)
