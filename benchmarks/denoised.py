"""Pictures of a short run, denoised, beside raw ones of a run eight times as long: FLIP against a reference; and relMSE
of pictures of few samples before and after each denoiser.

Pictures, pieces of references and measures are kept in a folder, each written when it is done: a command that was
stopped, or that asks for more seeds, goes on from there.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue import display, film, render, scene
from etendue.core import Result
from etendue.display.denoising import Picture

from .measuring import PUBLIC_SCENES, ROOT, Record, console
from .options import Names, Seeds, whole_numbers, words


@dataclass(frozen=True)
class Case:
    """A scene: the method that suits it, the size of the picture, and settings for pictures that are denoised."""

    method: str
    size: tuple[int, int]
    settings: Mapping[str, Any] = field(default_factory=dict)
    public: bool = False

    def source(self, name: str) -> str:
        """What is loaded."""
        return str(PUBLIC_SCENES / name / "scene.xml") if self.public else name


CASES = {
    "cornell-glass": Case("bpt", (512, 512)),
    "skylight": Case("path", (512, 384)),
    "grey-white-room": Case("path", (640, 360), public=True),
}
SCENES = ",".join(CASES)
#: Scenes for pictures of few samples.
FEW = {
    "cornell-glass": Case("bpt", (256, 256)),
    "skylight": Case("path", (256, 192)),
    "stage": Case("auto", (256, 192)),
}
FEW_SCENES = ",".join(FEW)
#: Difference of the albedo of a surface and of what it shows from which on a pixel counts as mirror or glass.
_MIRROR = 0.02
#: Seconds of a piece of a reference, and the seed of the first.
_PIECE, _REFERENCE_SEED = 60.0, 7001
#: Largest noise of a reference that tells pictures apart, relative to that of the raw picture of the long run.
_REFERENCE_SHARE = 0.25
#: The same of FLIP, between two halves of the reference.
_FLIP_SHARE = 0.5


def measure(
    scenes: Names = SCENES,
    denoisers: Annotated[Any, typer.Option(parser=words, metavar="NAMES")] = "oidn,nlm",
    short: Annotated[float, typer.Option(help="Seconds of the pictures that are denoised.")] = 5.0,
    long: Annotated[float, typer.Option(help="Seconds of the picture that is not.")] = 40.0,
    seeds: Seeds = 2,
    reference: Annotated[float, typer.Option(help="Seconds of a reference, in all its pieces.")] = 600.0,
    method: Annotated[str, typer.Option(help="Instead of the one that suits the scene.", metavar="NAME")] = "",
    only_reference: Annotated[bool, typer.Option("--only-reference", help="Make references, and end.")] = False,
    out: Annotated[str, typer.Option(help="Folder of what is kept.", metavar="DIR")] = "benchmarks-denoise",
) -> Iterator[Record]:
    """FLIP and relMSE of denoised pictures of a short run, and of the raw picture of a long one."""
    folder = ROOT / out
    folder.mkdir(parents=True, exist_ok=True)
    for name in scenes:
        case = CASES[name]
        truth = _reference(folder, name, case, reference)
        if not only_reference:
            used = method or case.method
            yield _compared(folder, name, case, used, list(denoisers), (short, long), range(1, seeds + 1), truth)


def few_samples(
    scenes: Names = FEW_SCENES,
    denoisers: Annotated[Any, typer.Option(parser=words, metavar="NAMES")] = "bilateral,guided,gaussian,nlm,oidn",
    samples: Annotated[Any, typer.Option(parser=whole_numbers, metavar="N,...")] = "4,16",
    seeds: Seeds = 2,
    reference: Annotated[float, typer.Option(help="Seconds of a reference, in all its pieces.")] = 180.0,
    out: Annotated[str, typer.Option(help="Folder of what is kept.", metavar="DIR")] = "benchmarks-denoise",
) -> Iterator[Record]:
    """relMSE of pictures of few samples, raw and denoised, everywhere and in mirrors and glass."""
    folder = ROOT / out
    folder.mkdir(parents=True, exist_ok=True)
    for name in scenes:
        case = FEW[name]
        truth = _reference(folder, name, case, reference)
        width, height = case.size
        record = Record(
            f"Denoised after few samples, {name} by {case.method}, {width}x{height}",
            ("", *(f"{what}, {count} samples" for count in samples for what in ("relMSE", "mirrors", "flat"))),
        )
        rows: dict[str, list[str]] = {}
        for count in samples:
            made = [_few(folder, name, case, count, seed) for seed in range(1, seeds + 1)]
            for kind in ["", *denoisers]:
                found = np.mean([_errors(layers, kind, truth.image) for layers in made], axis=0)
                rows.setdefault(kind or "raw", []).extend(f"{value:.3g}" for value in found)
        for row, values in rows.items():
            record.add(row, *values)
        record.notes += [
            f"relMSE: means of {seeds} seeds; mirrors: in the pixels that show mirrors or glass; flat: there, with the "
            "features of mirrors and glass in place of what they show",
            f"reference: {truth.about}, whose noise is a relMSE of {truth.noise:.2g}",
        ]
        yield record


def _few(folder: Path, name: str, case: Case, samples: int, seed: int) -> dict[str, Picture]:
    path = folder / f"{name}-{case.size[0]}x{case.size[1]}-{case.method}-{samples}-{seed}.exr"
    settings = {"for_denoising": True, **case.settings}
    made = _kept(path, lambda: _rendered(name, case, case.method, None, seed, settings, samples=samples))
    return made.layers


def _errors(layers: Mapping[str, Picture], denoiser: str, truth: Picture) -> tuple[float, float, float]:
    """relMSE of a picture, of its mirrors and glass, and of these with the features of the mirrors themselves."""
    flat = {name: layer for name, layer in layers.items() if not name.startswith("seen_")}
    mirrors = np.abs(layers["seen_albedo"] - layers["albedo"]).max(axis=2) > _MIRROR
    image, by_mirrors = (display.develop(some, denoiser or None, tell=lambda _: None) for some in (layers, flat))
    return (
        film.relative_mse(image, truth),
        film.relative_mse(image[mirrors][None], truth[mirrors][None]),
        film.relative_mse(by_mirrors[mirrors][None], truth[mirrors][None]),
    )


@dataclass(frozen=True)
class _Truth:
    """A reference, its relMSE by the scatter of its pieces, and what it is made of."""

    image: Picture
    noise: float
    flip: float  #: between its halves
    about: str


def _reference(folder: Path, name: str, case: Case, seconds: float) -> _Truth:
    """The mean of independent pieces, weighted by their samples. Those that are not there are rendered."""
    pieces: list[Picture] = []
    samples: list[int] = []
    for number in range(max(2, math.ceil(seconds / _PIECE))):
        path = folder / f"{name}-{case.size[0]}x{case.size[1]}-reference-{number}.exr"
        piece = _kept(path, lambda k=number: _rendered(name, case, case.method, _PIECE, _REFERENCE_SEED + k, {}))
        pieces.append(piece.image)
        samples.append(int(piece.metadata["samples"]))
    weights = np.array(samples) / sum(samples)
    image = np.tensordot(weights, np.stack(pieces), 1).astype(np.float32)
    scatter = sum(w**2 * np.square(piece - image) for w, piece in zip(weights, pieces, strict=True))
    variance = scatter * len(pieces) / (len(pieces) - 1.0)
    noise = float((variance / (np.square(image) + 0.01)).mean())
    about = f"{case.method}, {sum(samples)} samples a pixel in {len(pieces)} pieces of {_PIECE:g} s"
    first, second = (np.mean(pieces[start::2], axis=0, dtype=np.float32) for start in range(2))
    return _Truth(image, noise, film.flip(first, second), about)


def _compared(
    folder: Path,
    name: str,
    case: Case,
    method: str,
    denoisers: list[str],
    times: tuple[float, float],
    seeds: range,
    truth: _Truth,
) -> Record:
    short, long = times
    width, height = case.size
    measures = _Measures(folder / "measures.json", f"{name} {width}x{height} {method}", truth)
    record = Record(
        f"Denoised after {short:g} s, {name} by {method}, {width}x{height}",
        ("", "FLIP", "of the raw one", "relMSE", "s", "bar"),
    )
    found: dict[str, list[dict[str, float]]] = {}
    stem = f"{name}-{width}x{height}-{method}"
    for seed in seeds:
        # Kernels are compiled, and files read, before the clock runs.
        raw = _kept(
            folder / f"{stem}-{long:g}s-{seed}.exr",
            lambda s=seed: _rendered(name, case, method, long, s, {}, warm=True),
        )
        made = _kept(
            folder / f"{stem}-{short:g}s-{seed}.exr",
            lambda s=seed: _rendered(name, case, method, short, s, {"for_denoising": True, **case.settings}, warm=True),
        )
        rows: dict[str, Callable[[], Picture]] = {f"raw, {long:g} s": lambda r=raw: r.image}
        for kind in denoisers:
            rows[f"{kind}, {short:g} s"] = lambda m=made, k=kind: display.develop(m.layers, k, tell=lambda _: None)
        for row, one in measures.of(rows, folder / stem, seed).items():
            found.setdefault(row, []).append(one)
    bar = statistics.mean(one["flip"] for one in found[f"raw, {long:g} s"])
    noise = statistics.mean(one["relMSE"] for one in found[f"raw, {long:g} s"])
    is_known = truth.noise <= _REFERENCE_SHARE * noise and truth.flip <= _FLIP_SHARE * bar
    for row, ones in found.items():
        flips = [one["flip"] for one in ones]
        ratio = statistics.mean(flips) / bar
        reached = "" if row.startswith("raw") else "< 1: " + ("reached" if ratio < 1.0 else "missed")
        record.add(
            row,
            " ".join(f"{value:.4f}" for value in flips),
            f"{ratio:.3f}",
            " ".join(f"{one['relMSE']:.3g}" for one in ones),
            f"{statistics.mean(one['seconds'] for one in ones):.1f}",
            reached if is_known else "reference too noisy",
        )
    record.notes += [
        f"reference: {truth.about}; its noise, a relMSE of {truth.noise:.2g}, is {truth.noise / noise:.2g} of that of "
        f"the raw picture after {long:g} s, and part of every error; FLIP between its halves is {truth.flip:.3f}",
        f"samples a pixel: {made.metadata['samples']} after {short:g} s, {raw.metadata['samples']} after {long:g} s; "
        "the scene is loaded and kernels are compiled before; s: of denoising alone, after the rendering",
    ]
    return record


class _Measures:
    """Measures of pictures by name, kept in a file. They hold for one reference."""

    def __init__(self, path: Path, of: str, truth: _Truth) -> None:
        self._path, self._of, self._truth = path, of, truth

    def of(self, rows: Mapping[str, Callable[[], Picture]], stem: Path, number: int) -> dict[str, dict[str, float]]:
        """Those of pictures by row, which are made and written if they are not known. FLIP takes seconds on one core:
        processes measure two pictures at a time."""
        found: dict[str, dict[str, float]] = {}
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(2, mp_context=spawn) as pool:
            waiting = {}
            for row, make in rows.items():
                if (key := self._key(row, number)) in (known := self._known()):
                    found[row] = known[key]
                    continue
                begin = time.perf_counter()
                image = make()
                seconds = time.perf_counter() - begin
                film.write_exr(
                    stem.with_name(f"{stem.name}-{row.replace(', ', '-')}-{number}.exr"), Result({"image": image})
                )
                error = film.relative_mse(image, self._truth.image)
                waiting[pool.submit(film.flip, image, self._truth.image)] = row, {"relMSE": error, "seconds": seconds}
            for done in as_completed(waiting):
                row, one = waiting[done]
                found[row] = {"flip": done.result()} | one
                kept = self._known() | {self._key(row, number): found[row]}
                film.write_bytes(self._path, json.dumps(kept, indent=1).encode())
        for row in rows:
            values = f"FLIP {found[row]['flip']:.4f}, relMSE {found[row]['relMSE']:.4g}"
            console.print(f"{self._of}, seed {number}: {row}: {values}", style="dim")
        return {row: found[row] for row in rows}

    def _key(self, row: str, number: int) -> str:
        return f"{self._of}: {row}, seed {number}; {self._truth.about}"

    def _known(self) -> dict[str, dict[str, float]]:
        known: dict[str, dict[str, float]] = json.loads(self._path.read_text()) if self._path.is_file() else {}
        return known


def _kept(path: Path, make: Callable[[], Result]) -> Result:
    """The picture of a file, which is made if it is not there."""
    if not path.is_file():
        console.print(path.name, style="dim")
        film.write_exr(path, make())
    return film.read_exr(path)


def _rendered(
    name: str,
    case: Case,
    method: str,
    seconds: float | None,
    seed: int,
    settings: Mapping[str, Any],
    warm: bool = False,
    samples: int | None = None,
) -> Result:
    # One copy for all: kernels contain the materials of every scene in memory.
    problem = scene.load(case.source(name), size=case.size)
    source, settings = problem.scene, {"max_depth": problem.max_depth} | dict(settings)
    if warm:
        render(source, method, spp=2, size=case.size, seed=seed, **settings)
    made: Result = render(source, method, seconds=seconds, spp=samples, size=case.size, seed=seed, **settings)
    return made
