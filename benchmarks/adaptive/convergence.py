"""Errors over samples and over time (figures 6.6 to 6.9, tables 6.2 and 6.3 of the thesis), and what VEGAS's warm-up
costs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from etendue import display

from .. import plotting
from ..measuring import Record, console
from ..options import Out, ReferenceSeconds, Seconds, Seeds
from ..racing import TRIM, Entrant, Image, Point, marks, order, race
from .entrants import PER_PASS, WITHOUT_BSDF, integrand, of_the_thesis, ours, recipe
from .options import ALL, BOXES, OUT, PictureSize, Samples, Scenes
from .scenes import SIZES, open_scene

#: Numbers of samples whose pictures the thesis shows, relative to the last.
_SHOWN = 4


def over_samples(
    scenes: Scenes = ALL,
    size: PictureSize = None,
    samples: Samples = 256,
    seeds: Seeds = 2,
    reference_seconds: ReferenceSeconds = 30.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene. The thesis has up to 2048 samples."""
    for name in scenes:
        yield _over_samples(name, size or SIZES[name], samples, seeds, out, reference_seconds)


def _over_samples(
    name: str, size: tuple[int, int], samples: int, seeds: int, out: Path, reference_seconds: float
) -> Record:
    """RMS at growing numbers of samples, the order at each, and a sheet of the pictures."""
    reference = recipe(name).find(size, out, reference_seconds)
    theirs = of_the_thesis(name)
    at = _marks(samples)
    entrants = [*theirs, *ours(name)]
    sheet = _Sheet([*(entrant.label for entrant in theirs), entrants[-1].label], len(at))
    tracks = race(open_scene(name, size), entrants, reference.image, at, range(seeds), "samples", sheet.add)
    for unit, points in (("samples", plotting.over_samples), ("seconds", plotting.over_time)):
        curves = {label: points(track) for label, track in tracks.items()}
        plotting.save(out / f"{unit}-{name}.svg", curves, name, "samples a pixel" if unit == "samples" else unit)
    sheet.save(out / f"samples-{name}.png")
    shown = range(max(0, len(at) - _SHOWN - 2), len(at))
    record = Record(
        f"Convergence, {name}, {_by(size)}, {samples} samples a pixel",
        (
            "",
            *(f"RMS at {at[k]:g}" for k in shown),
            "to random",
            "time to random",
            "all pixels",
            "all pixels to random",
        ),
    )
    plain = tracks["random"][-1]
    for label, points in tracks.items():
        end = points[-1]
        relative = [f"{v:.2f}" for v in (end.rms / plain.rms, end.seconds / plain.seconds)]
        whole = (f"{end.untrimmed:.4f}", f"{end.untrimmed / plain.untrimmed:.2f}")
        record.add(label, *(points[k].text for k in shown), *relative, *whole)
    compared = {entrant.label: tracks[entrant.label] for entrant in theirs}
    record.notes += [
        "best first: " + "; ".join(f"at {at[k]:g} {order(compared, k)}" for k in shown[-_SHOWN:]),
        *(f"{label}: {overtakes(tracks['random'], points)}" for label, points in compared.items() if label != "random"),
        _integrand(name) + f", {PER_PASS} paths a pixel and pass; stratified explores, and chains start and have "
        "independent paths for their scale beside these",
        _errors(seeds, reference.note),
    ]
    return record


def equal_time(
    scenes: Scenes = ALL,
    size: PictureSize = None,
    seconds: Seconds = 20.0,
    seeds: Seeds = 3,
    reference_seconds: ReferenceSeconds = 60.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _equal_time(name, size or SIZES[name], seconds, seeds, out, reference_seconds)


def _equal_time(
    name: str, size: tuple[int, int], seconds: float, seeds: int, out: Path, reference_seconds: float
) -> Record:
    """RMS after the same time, and the pictures side by side."""
    reference = recipe(name).find(size, out, reference_seconds)
    at = marks(seconds, 4)
    entrants = [*of_the_thesis(name), *ours(name)]
    sheet = _Sheet([entrant.label for entrant in entrants], 1)
    tracks = race(
        open_scene(name, size),
        entrants,
        reference.image,
        at,
        range(seeds),
        look=lambda label, mark, image: sheet.add(label, 0, image) if mark == len(at) - 1 else None,
    )
    sheet.save(out / f"time-{name}.png")
    record = Record(
        f"Equal time, {name}, {_by(size)}, {seconds:g} s",
        ("", "samples a pixel", *(f"RMS at {mark:g} s" for mark in at), "to random"),
    )
    for label, points in tracks.items():
        ratio = points[-1].rms / tracks["random"][-1].rms
        record.add(label, f"{points[-1].samples:.0f}", *(p.text for p in points), f"{ratio:.2f}")
    record.notes += [_integrand(name), _errors(seeds, reference.note)]
    return record


#: How lights are found, and what adapts: with light points, and by hits alone, which leave more to learn.
FINDING = {"light points": ("mis", "light1; bounce1"), "hits": ("naive", "bounce1")}
#: Side in pixels of the tiles that learn a density each (0: the image), and samples of a pixel from which they learn.
LEARNERS = {"the image, from 64": (0, 64), "each pixel, from 64": (1, 64), "each pixel, from 256": (1, 256)}
_BINS = 8


def warm_up(
    scenes: Scenes = BOXES,
    size: PictureSize = "32x32",
    samples: Samples = 2048,
    seeds: Seeds = 1,
    reference_seconds: ReferenceSeconds = 20.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _warm_up(name, size or SIZES[name], samples, seeds, out, reference_seconds)


def _warm_up(name: str, size: tuple[int, int], samples: int, seeds: int, out: Path, reference_seconds: float) -> Record:
    """RMS of VEGAS relative to that of random paths over samples: a density for all pixels, or for each."""
    reference = recipe(name).find(size, out, reference_seconds)
    problem, at = open_scene(name, size), _marks(samples)
    record = Record(
        f"Warm-up of VEGAS, {name}, {_by(size)}: RMS relative to random",
        ("lights found by", "a density for; samples a pixel", *(f"at {mark:g}" for mark in at)),
    )
    for finding, (mode, groups) in FINDING.items():
        common = integrand(name) | {"mode": mode}
        learning = common | {"groups": groups, "bins": _BINS}
        entrants = [Entrant("random", "path", common)]
        for label, (side, count) in LEARNERS.items():
            entrants.append(Entrant(label, "vegas", learning | {"tile": side, "update": count // PER_PASS}))
        tracks = race(problem, entrants, reference.image, at, range(seeds), "samples")
        plain = tracks.pop("random")
        for label, points in tracks.items():
            ratios = [p.rms / q.rms for p, q in zip(points, plain, strict=True)]
            record.add(finding, label, *(f"{ratio:.3f}" for ratio in ratios))
            record.notes.append(f"{finding}, {label}: {overtakes(plain, points)}")
    record.notes += [
        f"{_BINS} x {_BINS} bins for light points and as many for the first direction",
        _integrand(name),
        _errors(seeds, reference.note),
    ]
    return record


def overtakes(plain: Sequence[Point], other: Sequence[Point]) -> str:
    """From which number of samples on the error of ``other`` stays below that of ``plain``."""
    below = [b.rms < a.rms for a, b in zip(plain, other, strict=True)]
    if not below[-1]:
        return "not below random at the end"
    first = len(below) - next((k for k, better in enumerate(reversed(below)) if not better), len(below))
    return f"below random from {other[first].samples:g} samples on"


def _marks(samples: int) -> list[float]:
    """Powers of two from a pass on."""
    return marks(samples, max(1, samples // PER_PASS).bit_length())


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _integrand(name: str) -> str:
    directions = "uniformly" if name in WITHOUT_BSDF else "by the materials"
    return f"independent numbers, directions drawn {directions} ('our settings': even numbers, by the materials)"


def _errors(seeds: int, reference: str) -> str:
    return (
        f"RMS of the difference of luminance, without the worst {TRIM:.1%} of the pixels; root of the mean of {seeds} "
        f"seed{'s' if seeds > 1 else ''}; reference: {reference}"
    )


class _Sheet:
    """Pictures of each method (rows) at the last marks (columns)."""

    def __init__(self, labels: Sequence[str], count: int) -> None:
        self._rows: Mapping[str, dict[int, Image]] = {label: {} for label in labels}
        self._columns = range(max(0, count - _SHOWN), count)

    def add(self, label: str, mark: int, image: Image) -> None:
        """Keep a picture, if it is one to show."""
        if label in self._rows and mark in self._columns:
            self._rows[label][mark] = image

    def save(self, path: Path) -> None:
        """Write all that there are, with one exposure."""
        last = next(iter(self._rows.values()))[self._columns[-1]]
        exposure = display.auto_exposure(last)
        rows: list[NDArray[np.float32]] = []
        for images in self._rows.values():
            empty = np.zeros_like(last)
            rows.append(np.concatenate([images.get(mark, empty) for mark in self._columns], axis=1))
        path.parent.mkdir(parents=True, exist_ok=True)
        display.write_png(path, display.tonemap(np.concatenate(rows), exposure))
        console.print(f"pictures: {path}", style="dim")
