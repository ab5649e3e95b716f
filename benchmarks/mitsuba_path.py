"""``path`` beside Mitsuba's own ``path``: error at equal samples filter by filter, error after equal time, samples a
second. Both render the same scene objects, in turn."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import typer

from etendue import film, methods, scene
from etendue.core import OptionError, Replica
from etendue.scene import Problem, bundled

from .choice import scaled_size
from .measuring import PUBLIC_SCENES, Record, console, interleaved, verdict
from .mitsuba_pictures import picture
from .options import Names, Pixels, Rounds, Seconds, Seeds, named, whole_numbers
from .quality import filtered

FILTERS = ("box", "tent", "gaussian", "mitchell", "lanczos")
SCENES = "cornell-box,grey-white-room,wooden-staircase"
#: Error at equal samples relative to Mitsuba's, by sampler; and after equal time.
BARS = {"independent": 1.05, "owen": 0.9}
TIME_BAR = 0.9
#: Samples a second relative to the best that Mitsuba does, at least.
SPEED_BAR = 0.97
#: Samples a pixel of Mitsuba's passes that are tried for its best.
_PASSES = (1, 4, 16, 64)
#: Camera paths of the largest of them in `speed`: more take long, and were never the fastest.
_MOST_PATHS = 1 << 20
#: Samples of a reference, relative to those of a picture; in two halves.
_LONGER = 32
#: Share of the brightest errors that is left out: one firefly must not decide.
_TRIM = 0.001


def _problem(name: str, pixels: int, kind: str | None = None) -> Problem:
    """A scene at about so many pixels, with the filter ``kind`` instead of its own."""
    source: Any = name
    if name in bundled():
        if kind is not None:
            source = bundled()[name].build()
            source["sensor"]["film"] |= {"rfilter": {"type": kind}}
    else:
        folder = PUBLIC_SCENES / name
        source = folder / "scene.xml" if kind is None else filtered(folder, kind)
    return scene.load(source, size=scaled_size(source, pixels, larger=True))


def _by_mitsuba(problem: Problem, spp: int, seed: int) -> np.ndarray:
    """A picture by Mitsuba, in parts that fit its sampler."""
    return picture(problem, seed, spp=spp, part=spp // -(-spp // 256))[0]


def _by_us(problem: Problem, spp: int, seed: int, sampler: str) -> np.ndarray:
    method = methods.get("path")
    path = method(method.Settings(max_depth=problem.max_depth, sampler=sampler, samples_per_pass=min(spp, 16)))
    path.prepare(problem, seed)
    replica = Replica(path, seed)
    total = replica.step(0)
    for iteration in range(1, spp // path.samples_per_iteration):
        total += replica.step(iteration)
    return replica.develop(total).image


def _error(image: np.ndarray, halves: Sequence[np.ndarray]) -> float:
    """Error against the mean of the halves, less that of the mean itself."""
    mean = (halves[0] + halves[1]) / 2
    return max(film.relative_mse(image, mean, trim=_TRIM) - film.relative_mse(halves[0], mean, trim=_TRIM), 0.0)


def measure(
    part: Annotated[str, typer.Option(help="samples, time or speed; all by default.")] = "",
    scenes: Names = SCENES,
    filters: Annotated[
        Any, typer.Option(parser=named(FILTERS, "filter"), help="Filters, separated by commas.", metavar="NAMES")
    ] = "box,tent,gaussian,mitchell,lanczos",
    pixels: Pixels = 16384,
    spp: Annotated[int, typer.Option(min=16, help="Samples a pixel of `samples`.")] = 64,
    seconds: Seconds = 30.0,
    seeds: Seeds = 3,
    sides: Annotated[
        Any, typer.Option(parser=whole_numbers, help="Of `speed`: the root of the number of pixels.", metavar="N,...")
    ] = "128,256,512,1024",
    rounds: Rounds = 7,
) -> Iterator[Record]:
    """Error at equal samples, error after equal time, samples a second."""
    if part not in ("", "samples", "time", "speed"):
        raise OptionError(f"--part is samples, time or speed, not '{part}'")
    if part in ("", "samples"):
        yield equal_samples(scenes, filters, pixels, spp, seeds)
    if part in ("", "time"):
        yield equal_time([*scenes, "veach-bidir"], pixels, seconds, seeds)
    if part in ("", "speed"):
        for name in scenes:
            yield speed(name, sides, rounds)


def equal_samples(names: Sequence[str], filters: Sequence[str], pixels: int, spp: int, seeds: int) -> Record:
    """Errors after ``spp`` samples by each filter, relative to Mitsuba's."""
    record = Record(
        f"path and Mitsuba's path, {spp} samples, about {pixels} pixels",
        ("", "filter", "Mitsuba", "independent", "to Mitsuba", "bar", "owen", "to Mitsuba", "bar"),
    )
    for name in names:
        for kind in filters:
            problem = _problem(name, pixels, kind)
            halves = [_by_mitsuba(problem, _LONGER * spp // 2, 900 + half) for half in range(2)]
            errors: dict[str, list[float]] = {"Mitsuba": [], "independent": [], "owen": []}
            for seed in range(seeds):
                errors["Mitsuba"].append(_error(_by_mitsuba(problem, spp, seed), halves))
                for sampler in ("independent", "owen"):
                    errors[sampler].append(_error(_by_us(problem, spp, seed, sampler), halves))
            middle = {who: statistics.median(values) for who, values in errors.items()}
            cells = [name, kind, f"{middle['Mitsuba']:.4g}"]
            for sampler, bar in BARS.items():
                ratio = middle[sampler] / middle["Mitsuba"]
                cells += [f"{middle[sampler]:.4g}", f"{ratio:.2f}", verdict(ratio, bar)]
            record.add(*cells)
            console.print("  ".join(cells), style="dim")
    record.notes.append(
        f"relMSE without the worst 0.1 %, median of {seeds} seeds; reference: Mitsuba's path, {_LONGER * spp} samples "
        "in two halves, whose difference tells its own error, which is taken off"
    )
    return record


def equal_time(names: Sequence[str], pixels: int, seconds: float, seeds: int) -> Record:
    """Errors after ``seconds`` by the scenes' own filters, with the defaults of both, in turn and warm."""
    record = Record(
        f"path and Mitsuba's path, {seconds:g} s, about {pixels} pixels",
        ("", "filter", "Mitsuba", "spp", "path", "spp", "ratio", "bar"),
    )
    for name in names:
        problem = _problem(name, pixels)
        long = max(1024, int(40 * seconds))
        halves = [_by_mitsuba(problem, long, 900 + half) for half in range(2)]
        kind = str(problem.sensor.film().rfilter()).split("[")[0].replace("Filter", "").strip()
        rows: dict[str, list[tuple[float, float]]] = {"Mitsuba": [], "path": []}
        for seed in range(seeds):
            for who, values in rows.items():
                gc.collect()
                image, spp = (_timed_mitsuba if who == "Mitsuba" else _timed_us)(problem, seconds, seed)
                values.append((_error(image, halves), spp))
        (theirs, their_spp), (ours, our_spp) = (
            [statistics.median(column) for column in zip(*values, strict=True)] for values in rows.values()
        )
        ratio = ours / theirs
        record.add(
            name,
            kind,
            f"{theirs:.4g}",
            f"{their_spp:.0f}",
            f"{ours:.4g}",
            f"{our_spp:.0f}",
            f"{ratio:.2f}",
            verdict(ratio, TIME_BAR),
        )
    record.notes.append(
        f"relMSE without the worst 0.1 %, median of {seeds} seeds, less that of the reference, by Mitsuba's path; "
        f"kernels are compiled before; Mitsuba renders by passes of the fastest of {_PASSES} samples"
    )
    return record


def _timed_mitsuba(problem: Problem, seconds: float, seed: int) -> tuple[np.ndarray, float]:
    """Passes of the size that is the fastest of :data:`_PASSES`."""
    integrator = mi.load_dict({"type": "path", "max_depth": problem.max_depth})
    image, spp, _ = picture(problem, seed, seconds=seconds, part=_best_pass(problem, integrator))
    return image, spp


def _best_pass(problem: Problem, integrator: Any) -> int:
    rates = {}
    for part in _PASSES:
        _pass(problem, integrator, part, 0)
        begin = time.perf_counter()
        _pass(problem, integrator, part, 1)
        rates[part] = part / (time.perf_counter() - begin)
    return max(rates, key=rates.__getitem__)


def _pass(problem: Problem, integrator: Any, part: int, seed: int) -> None:
    dr.eval(mi.render(problem.scene, sensor=problem.sensor, integrator=integrator, spp=part, seed=seed))
    dr.sync_thread()


def _timed_us(problem: Problem, seconds: float, seed: int) -> tuple[np.ndarray, float]:
    method = methods.get("path")
    path = method(method.Settings(max_depth=problem.max_depth))
    path.prepare(problem, seed)
    replica = Replica(path, seed)
    replica.step(10_000)  # compiles
    begin = time.perf_counter()
    total, count, took = replica.step(0), 1, 0.0
    while time.perf_counter() - begin + took <= seconds:
        began = time.perf_counter()
        total += replica.step(count)
        count, took = count + 1, time.perf_counter() - began
    return replica.develop(total).image, float(count * path.samples_per_iteration)


def speed(name: str, sides: Sequence[int], rounds: int) -> Record:
    """Samples a second at several sizes, relative to the best of Mitsuba's passes."""
    record = Record(
        f"Samples a second of path and Mitsuba's path, {name}",
        ("", "spp a pass", "path", *(f"Mitsuba, {n} spp" for n in _PASSES), "to its best", "by CPU time", "bar"),
    )
    for side in sides:
        problem = _problem(name, side * side)
        integrator = mi.load_dict({"type": "path", "max_depth": problem.max_depth})
        method = methods.get("path")
        path = method(method.Settings(max_depth=problem.max_depth))
        path.prepare(problem, 0)
        most = _MOST_PATHS // (side * side)
        tasks: dict[Any, Any] = {"path": Replica(path, 0).step}
        for part in _PASSES:
            if part <= most:
                tasks[part] = partial(_pass, problem, integrator, part)
        times = interleaved(tasks, rounds, 1)
        own = path.samples_per_iteration
        samples = {"path": own} | {part: part for part in tasks if part != "path"}
        rates = {who: samples[who] / statistics.median(c.wall for c in clocks) for who, clocks in times.items()}
        by_cpu = {who: samples[who] / statistics.median(c.cpu for c in clocks) for who, clocks in times.items()}
        ratio, judged = (
            all_rates["path"] / max(rate for who, rate in all_rates.items() if who != "path")
            for all_rates in (rates, by_cpu)
        )
        size = "x".join(map(str, problem.size))
        cells = [f"{rates[part]:.2f}" if part in rates else "" for part in _PASSES]
        enough = f"≥ {SPEED_BAR:g}: {'reached' if judged >= SPEED_BAR else 'missed'}"
        record.add(size, str(own), f"{rates['path']:.2f}", *cells, f"{ratio:.2f}", f"{judged:.2f}", enough)
        console.print(f"{size}: {ratio:.2f}, by CPU time {judged:.2f}", style="dim")
    record.notes.append(
        f"samples a pixel and second; passes in turn, median of {rounds} rounds after 1; Mitsuba's of at most "
        f"{_MOST_PATHS} paths; the bar is for CPU time, which other work on the machine disturbs less"
    )
    return record
