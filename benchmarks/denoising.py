"""Denoisers: the time of the filters, and pictures of a short run, denoised, beside those of a long run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import drjit as dr
import numpy as np
import typer

from etendue import display, film, scene
from etendue.api import render
from etendue.core import BackendError, OptionError, Result
from etendue.display.denoising import Features, Picture

from .measuring import PUBLIC_SCENES, ROOT, Record, console, interleaved, verdict
from .options import Names, Rounds, Size, words

#: Milliseconds of a component of 512x512 pixels with a radius of 5, on two cores.
BARS = {"gaussian": 30.0, "bilateral": 100.0, "guided": 100.0}
BAR_SIZE, BAR_RADIUS, BAR_CORES = (512, 512), 5, 2
#: Scenes and the method by which each is rendered.
METHODS = {"cornell-glass": "bpt", "skylight": "path", "grey-white-room": "path"}
SCENES = ",".join(METHODS)
#: Camera paths per pixel and pass of the pictures that are denoised: several passes tell the variance.
_SAMPLES = 4
#: Seeds of the picture and of the halves of the reference.
_SEED, _REFERENCE_SEED = 1, 7001


def filters(size: Size = "512x512", radius: int = BAR_RADIUS, rounds: Rounds = 11) -> Record:
    """Milliseconds of each filter for one component, with and without features."""
    width, height = size
    rng = np.random.default_rng(0)
    component, albedo, normal, variance = rng.random((4, height, width, 3), dtype=np.float32)
    tasks, kinds = {}, ("gaussian", "bilateral", "guided", "nlm")
    for name in kinds:
        for with_features in (False, True):
            features = Features(albedo, normal, variance) if with_features else Features(variance=variance)
            tasks[name, with_features] = _task(name, component, features, radius)
    clocks = interleaved({str(key): task for key, task in tasks.items()}, rounds, 2)
    cores = min(dr.thread_count(), BAR_CORES)
    record = Record(
        f"Filters, one component of {width}x{height}, radius {radius}",
        ("", "features", "ms", f"CPU ms / {cores} cores", "bar"),
    )
    comparable = tuple(size) == BAR_SIZE and radius == BAR_RADIUS
    for name, with_features in tasks:
        found = clocks[str((name, with_features))]
        wall, cpu = (1e3 * statistics.median(getattr(c, kind) for c in found) for kind in ("wall", "cpu"))
        bar = verdict(cpu / cores, BARS.get(name)) if comparable else ""
        record.add(name, "albedo, normal" if with_features else "none", f"{wall:.0f}", f"{cpu / cores:.0f}", bar)
    record.notes.append(
        f"median of {rounds} rounds in turn after 2 to warm up, from arrays of the host to arrays of the host; the bar "
        "is held against CPU time, since a busy machine makes the clock longer"
    )
    return record


def _task(name: str, component: Picture, features: Features, radius: int) -> Any:
    return lambda _: display.denoiser(name).function(component, features, radius, 1.0)


def measure(
    scenes: Names = SCENES,
    denoisers: Annotated[Any, typer.Option(parser=words, metavar="NAMES")] = "oidn,bilateral,guided,gaussian,nlm",
    size: Size = "512x512",
    short: Annotated[float, typer.Option(help="Seconds of the pictures that are denoised.")] = 5.0,
    long: Annotated[float, typer.Option(help="Seconds of the picture that is not.")] = 40.0,
    reference: Annotated[float, typer.Option(help="Seconds of a reference that is not there yet.")] = 600.0,
    cpu: Annotated[bool, typer.Option("--cpu", help="Seconds of CPU time in all, for a busy machine.")] = False,
    out: Annotated[str, typer.Option(help="Folder of references and pictures.", metavar="DIR")] = "benchmarks-denoise",
) -> Iterator[Record]:
    """FLIP and relMSE of denoised pictures of a short run, and of the raw picture of a long one."""
    folder = ROOT / out
    folder.mkdir(parents=True, exist_ok=True)
    for name in scenes:
        path = PUBLIC_SCENES / name / "scene.xml"
        source, method = (
            (str(path) if path.is_file() and name == "grey-white-room" else name),
            METHODS.get(name, "path"),
        )
        wanted = size if source == name else (size[0], round(size[0] * 9 / 16))
        yield _scene(name, source, method, wanted, list(denoisers), (short, long, reference), cpu, folder)


def _scene(
    name: str,
    source: str,
    method: str,
    size: tuple[int, int],
    denoisers: list[str],
    times: tuple[float, float, float],
    cpu: bool,
    folder: Path,
) -> Record:
    short, long, for_reference = times
    unit = "CPU s" if cpu else "s"
    truth, about = _reference(folder / f"{name}-{size[0]}x{size[1]}.exr", source, method, size, for_reference, cpu)
    record = Record(
        f"Denoised after {short:g} {unit}, {name} by {method}, {size[0]}x{size[1]}",
        ("", "FLIP", "relMSE", "without worst 0.1 %", "bar"),
    )
    raw = _run(source, method, size, long, cpu, _SEED, {})
    bar = film.flip(raw.image, truth)

    def add(what: str, image: Picture, barred: bool = False) -> None:
        flip, error = film.flip(image, truth), film.relative_mse(image, truth)
        trimmed = film.relative_mse(image, truth, trim=0.001)
        record.add(what, f"{flip:.4f}", f"{error:.4g}", f"{trimmed:.4g}", verdict(flip, bar) if barred else "")
        film.write_exr(folder / f"{name}-{what.replace(' ', '-').replace(',', '')}.exr", Result({"image": image}))
        console.print(f"{name}, {what}: FLIP {flip:.4f}", style="dim")

    add(f"raw, {long:g} {unit}", raw.image)
    for reconstruction in ("neighbours", "independent"):
        own = {"aovs": True, "components": True, "reconstruction": reconstruction, "samples_per_pass": _SAMPLES}
        made = _run(source, method, size, short, cpu, _SEED, own)
        film.write_exr(folder / f"{name}-{reconstruction}.exr", Result(made.layers, made.metadata))
        add(f"raw, {short:g} {unit}, {reconstruction}", made.image)
        row = [made.image]
        for kind in denoisers:
            try:
                image = display.develop(made.layers, kind, components=["image"])
            except (BackendError, OptionError) as error:
                console.print(str(error), style="dim")
                continue
            add(f"{kind}, {reconstruction}", image, barred=True)
            row.append(image)
            if display.denoiser(kind).by_component:
                add(f"{kind} by component, {reconstruction}", display.develop(made.layers, kind), barred=True)
        exposure = display.auto_exposure(truth)
        pixels = np.concatenate([display.tonemap(image, exposure, "agx") for image in row], axis=1)
        display.write_png(folder / f"{name}-{reconstruction}.png", pixels)
    record.notes += [
        f"reference: {about}",
        f"bar: FLIP of the raw picture after {long:g} {unit}, {raw.metadata['samples']} samples a pixel; the short "
        f"ones have {made.metadata['samples']}",
    ]
    return record


def _reference(
    path: Path, source: str, method: str, size: tuple[int, int], seconds: float, cpu: bool
) -> tuple[Picture, str]:
    if not path.is_file():
        console.print(f"{path.name}: {seconds:g} s", style="dim")
        made = _run(source, method, size, seconds, cpu, _REFERENCE_SEED, {})
        film.write_exr(path, Result({"image": made.image}, made.metadata))
    result = film.read_exr(path)
    return result.image, f"{result.metadata['method']}, {result.metadata['samples']} samples a pixel"


def _run(
    source: str, method: str, size: tuple[int, int], seconds: float, cpu: bool, seed: int, settings: dict[str, Any]
) -> Any:
    """A picture by wall time, or by CPU time of all threads, preparation included and loading not."""
    if not cpu:
        return render(source, method, seconds=seconds, size=size, seed=seed, **settings)
    begin = time.process_time()
    scene.load(source, size=size)
    end = 2.0 * time.process_time() - begin + seconds
    return render(
        source, method, samples=1 << 20, size=size, seed=seed, callback=lambda _: time.process_time() < end, **settings
    )
