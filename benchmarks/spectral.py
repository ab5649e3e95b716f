"""Spectral variants: error in the spectrum of a prism after a given time, and the cost of a pass beside RGB."""

from __future__ import annotations

import gc
import statistics
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mitsuba as mi
import numpy as np

from etendue import methods, render, scene
from etendue.core import Replica
from etendue.film import relative_mse

from .measuring import COST_SCENE, Clock, Record, console, spread, timed, verdict
from .mitsuba_pictures import picture
from .options import Names, Rounds, Seconds, Seeds, Size, WarmUp

#: Largest error in the spectrum after a minute, and largest cost of a spectral pass relative to one in RGB.
BARS, COST_BAR = {"vcm": 0.01}, 1.6
#: Mitsuba's integrator, as a row.
_MITSUBA = "Mitsuba path"
#: Least difference of two channels, relative to the largest, of a pixel of the spectrum, and its least value.
_COLOURED, _LIT = 0.4, 1.0
#: Times the time of a picture for each half of the reference.
_HALF = 4.0


@contextmanager
def _colours(name: str) -> Iterator[None]:
    backend = mi.variant().partition("_")[0]
    with mi.variant_context(f"{backend}_ad_{name}"):
        yield


def prism(
    names: Names = "light,bpt,vcm,auto,path", size: Size = "256x256", seconds: Seconds = 60.0, seeds: Seeds = 1
) -> Record:
    """The scene ``prism``, one method after the other."""
    with _colours("spectral"):
        return _prism([*names, _MITSUBA], size, seconds, seeds)


def _prism(names: list[str], size: tuple[int, int], seconds: float, seeds: int) -> Record:
    halves = [render("prism", "light", seconds=_HALF * seconds, size=size, seed=1000 + half).image for half in range(2)]
    reference = (halves[0] + halves[1]) / 2
    most = reference.max(axis=2)
    spectrum = (most > _LIT) & (most - reference.min(axis=2) > _COLOURED * most)
    own = relative_mse(halves[0][spectrum][None], reference[spectrum][None])
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for seed in range(seeds):
        for name in names:
            gc.collect()
            image, samples = _taken(name, size, seconds, seed)
            error = relative_mse(image[spectrum][None], reference[spectrum][None]) - own
            found[name].append((max(error, 0.0), samples))
            console.print(f"{name}, seed {seed}: {error:.4g}", style="dim")
    record = Record(
        f"Prism, {size[0]}x{size[1]}, {seconds:g} s",
        ("", "relMSE in the spectrum", "spp", "bar"),
    )
    for name, rows in found.items():
        error, samples = (statistics.median(column) for column in zip(*rows, strict=True))
        bar = verdict(error, BARS[name]) if name in BARS else ""
        record.add(name, f"{error:.3g}", f"{samples:.0f}", bar)
    record.notes += [
        f"the spectrum: {spectrum.sum()} pixels, bright and coloured in the reference, which is by light, "
        f"{2 * _HALF * seconds:g} s in two halves, whose difference ({own:.2g}) is subtracted",
        f"median of {seeds} seed{'s' if seeds > 1 else ''}; one after the other in one process; the time begins when "
        "the scene is loaded, compilation included",
    ]
    return record


def _taken(name: str, size: tuple[int, int], seconds: float, seed: int) -> tuple[np.ndarray, float]:
    """(picture, samples a pixel) of a run."""
    if name == _MITSUBA:
        made = picture(scene.load("prism", size=size), seed, seconds=seconds, part_seconds=0.5, integrator="path")
        return made[0], made[1]
    result = render("prism", name, seconds=seconds, size=size, seed=seed)
    return result.image, float(result.metadata["samples"])


def cost(
    names: Names = "path,light,bpt,vcm,sppm",
    source: str = COST_SCENE,
    size: Size = "256x256",
    rounds: Rounds = 9,
    warm_up: WarmUp = 2,
) -> Record:
    """Passes of four samples a pixel in turn, in RGB and with wavelengths."""
    tasks: dict[str, dict[str, Callable[[int], Any]]] = {}
    for colours in ("rgb", "spectral"):
        with _colours(colours):
            problem = scene.load(source, size=size)
            tasks[colours] = {name: _pass(name, problem) for name in [*names, _MITSUBA]}
    times: dict[tuple[str, str], list[Clock]] = {(name, own): [] for own, row in tasks.items() for name in row}
    for number in range(warm_up + rounds):
        for colours, row in tasks.items():
            with _colours(colours):  # to change the variant takes as long as a pass, and is not timed
                for name, step in row.items():
                    clock = timed(step, number)
                    if number >= warm_up:
                        times[name, colours].append(clock)
    record = Record(
        f"Cost of a pass with wavelengths, {source}, {size[0]}x{size[1]}", ("", "RGB s", "spectral s", "ratio", "bar")
    )
    for name in [*names, _MITSUBA]:
        plain, ours = (times[name, colours] for colours in tasks)
        ratios = [a.wall / b.wall for a, b in zip(ours, plain, strict=True)]
        middle = [f"{statistics.median(clock.wall for clock in clocks):.3f}" for clocks in (plain, ours)]
        bar = verdict(statistics.median(ratios), COST_BAR) if name != _MITSUBA else ""
        record.add(name, *middle, spread(ratios), bar)
    record.notes.append(
        f"passes of 4 samples a pixel; median (min … max) of {rounds} rounds after {warm_up} to warm up; a ratio is "
        "that of two passes of one round"
    )
    return record


def _pass(name: str, problem: scene.Problem) -> Callable[[int], Any]:
    if name == _MITSUBA:
        integrator = mi.load_dict({"type": "path", "max_depth": 10})
        return lambda number: np.array(
            mi.render(problem.scene, sensor=problem.sensor, integrator=integrator, spp=4, seed=number)
        )
    kind = methods.get(name)
    method = kind(kind.Settings.from_mapping({"samples_per_pass": 4, "max_depth": 10}))
    method.prepare(problem, 0)
    return Replica(method, 0).step
