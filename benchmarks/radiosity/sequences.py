"""Error over time and lines for each sequence, and how steeply it falls (sections 3.3 and 3.3.8 of the thesis, table
3.1); direct light against the whole solution (section 3.5)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from etendue.radiosity import RayScene

from .. import plotting
from ..measuring import Record, verdict
from ..options import Out, Seeds
from .drivers import DRIVERS, INDEPENDENT
from .options import BUNDLES, EVERY, GOOD, OUT, RAYS, Detail, Least, Lines, Rays, ReferenceBundles, Scenes, Sequences
from .references import Reference, mean_squared_error, opened
from .sweeping import Task, Track, half_and_half, marks, shot_only, sweep

#: What the thesis says of errors relative to those of independent numbers, at equal time.
_THESIS = {
    "halton": "0.5",
    "scrambled halton": "0.5, 10 % more time",
    "sobol": "0.5",
    "weyl": "0.5, none with few lines",
    "hammersley": "no gain",
    "consecutive halton": "invalid",
}
#: Slopes of table 3.1.
_SLOPES = {
    "six-cubes": {"halton": -1.098, "sobol": -1.102, "hammersley": -0.884, "weyl": -1.157, INDEPENDENT: -1.0},
    "room": {"halton": -1.113, "sobol": -1.122, "hammersley": -0.874, "weyl": -1.132, INDEPENDENT: -1.0},
}
#: Curves of a plot, which has six styles.
_PLOTS = {
    "sequences": (INDEPENDENT, "halton", "scrambled halton", "sobol", "weyl", "hammersley"),
    "causes": (INDEPENDENT, "owen-sobol", "weyl", "golden weyl", "hammersley", "shuffled hammersley"),
}
#: Issue 5 asks for this from Halton's or Sobol's points on six-cubes.
_BAR = 0.65
#: The last numbers of lines whose ratios are averaged.
_LAST = 4


def tasks(scene: RayScene, exact: Reference, names: list[str]) -> dict[str, Task]:
    """The whole solution, for each of the sequences."""
    patches = scene.patches

    def error(name: str, lines: int, seed: int) -> float:
        return mean_squared_error(patches, half_and_half(scene, DRIVERS[name], lines, seed).radiosity, exact.radiosity)

    return {name: partial(error, name) for name in names}


def direct_tasks(scene: RayScene, exact: Reference, names: list[str]) -> dict[str, Task]:
    """The first shot alone, for each of the sequences."""
    patches = scene.patches

    def error(name: str, lines: int, seed: int) -> float:
        return mean_squared_error(patches, shot_only(scene, DRIVERS[name], lines, seed), exact.direct)

    return {name: partial(error, name) for name in names}


def measure(
    scenes: Scenes = "six-cubes,room",
    sequences: Sequences = EVERY,
    lines: Lines = 1 << 19,
    least: Least = 1 << 13,
    seeds: Seeds = 10,
    detail: Detail = 1.0,
    rays: Rays = RAYS,
    bundles: ReferenceBundles = BUNDLES,
    out: Out = OUT,
) -> Iterator[Record]:
    """Two tables of each scene."""
    for name in scenes:
        yield from _scene(name, *opened(name, detail, rays, bundles), sequences, lines, least, seeds, out)


def _scene(
    title: str, scene: RayScene, exact: Reference, names: list[str], lines: int, least: int, seeds: int, out: Path
) -> list[Record]:
    """Two tables: errors relative to independent numbers, and slopes."""
    tracks = sweep(tasks(scene, exact, names), marks(lines, least), seeds)
    plain = tracks[INDEPENDENT]
    label = "mean squared error of the radiosity"
    for plot, shown in _PLOTS.items():
        curves = {name: tracks[name].points for name in shown if name in tracks}
        plotting.save(out / f"{plot}-{title}.svg", curves, title, "local and as many global lines", label, 1.0)
    in_time = {name: tracks[name].points_in_time for name in _PLOTS["sequences"] if name in tracks}
    plotting.save(out / f"sequences-time-{title}.svg", in_time, title, "seconds", label, 1.0)
    heading = f"{title}, {len(scene.patches)} patches, {lines} local and {lines} global lines, {seeds} seeds"
    return [_errors(heading, title, tracks, plain, exact), _slopes(heading, title, tracks)]


def _errors(heading: str, title: str, tracks: dict[str, Track], plain: Track, exact: Reference) -> Record:
    shown = range(max(0, len(plain.lines) - _LAST), len(plain.lines))
    record = Record(
        f"Sequences, {heading}",
        (
            *("", "MSE", *(f"to independent at {plain.lines[k]:.0f}" for k in shown), f"last {len(shown)}"),
            *("seconds", "time to independent", "thesis", "bar"),
        ),
    )
    time = np.median(plain.seconds[:, -1])
    for name, track in tracks.items():
        last = track.ratio(plain, len(shown))
        mine = np.median(track.seconds[:, -1])
        has_bar = title == "six-cubes" and name in ("halton", "sobol", "owen-sobol")
        record.add(
            *(name, f"{track.mean[-1]:.3g}", *(f"{track.mean[k] / plain.mean[k]:.2f}" for k in shown), str(last)),
            *(f"{mine:.2f}", f"{mine / time:.2f}", _THESIS.get(name, "")),
            verdict(last.value, _BAR if has_bar else None),
        )
    best = min(track.mean[-1] for track in tracks.values())
    record.notes += [
        "multipath line by line after a first shot, sphere pairs; each seed moves a sequence another way",
        f"last {len(shown)}: geometric mean of the ratios before it, with its standard error from the seeds",
        f"noise of the reference: {exact.noise:.2g}, {exact.noise / best:.1%} of the least error here",
    ]
    return record


def _slopes(heading: str, title: str, tracks: dict[str, Track]) -> Record:
    first, last = (tracks[INDEPENDENT].lines[k] for k in (0, -1))
    record = Record(f"Slopes, {heading}", ("", "over lines", "over seconds", "thesis, over seconds"))
    for name, track in tracks.items():
        thesis = _SLOPES.get(title, {}).get(name)
        over_time = track.slope(np.median(track.seconds, axis=0))
        record.add(name, str(track.slope()), str(over_time), "" if thesis is None else f"{thesis:.2f}")
    record.notes.append(
        f"of log MSE, by least squares, from {first:.0f} to {last:.0f} lines; errors from the seeds. Some time does "
        "not depend on the number of lines (launches of kernels): slopes over seconds are steeper"
    )
    return record


def direct(
    scenes: Scenes = "six-cubes",
    sequences: Sequences = GOOD,
    lines: Lines = 1 << 17,
    least: Least = 1 << 13,
    seeds: Seeds = 16,
    detail: Detail = 1.0,
    rays: Rays = RAYS,
    bundles: ReferenceBundles = BUNDLES,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _direct(name, *opened(name, detail, rays, bundles), sequences, lines, least, seeds, out)


def _direct(
    title: str, scene: RayScene, exact: Reference, names: list[str], lines: int, least: int, seeds: int, out: Path
) -> Record:
    """By how much sequences reduce the error of direct light and of the whole solution."""
    counts = marks(lines, least)
    parts = {
        "direct": sweep(direct_tasks(scene, exact, names), counts, seeds),
        "whole": sweep(tasks(scene, exact, names), counts, seeds),
    }
    curves = {f"{part}, {name}": track.points for part, tracks in parts.items() for name, track in tracks.items()}
    label = "mean squared error of the radiosity"
    plotting.save(out / f"direct-{title}.svg", curves, title, "local (and as many global) lines", label, 1.0)
    shown = range(max(0, len(counts) - _LAST), len(counts))
    record = Record(
        f"Direct light and the whole solution, {title}, {len(scene.patches)} patches, {lines} lines, {seeds} seeds",
        ("", "of", "MSE", *(f"reduced at {counts[k]}" for k in shown), f"last {len(shown)}", "thesis"),
    )
    for name in names:
        for part, tracks in parts.items():
            track, plain = tracks[name], tracks[INDEPENDENT]
            cells = ["", "", "", "", ""][: len(shown)]
            last, thesis = "", ""
            if name != INDEPENDENT:
                ratio = track.ratio(plain, len(shown))
                cells = [f"{1 - track.mean[k] / plain.mean[k]:.0%}" for k in shown]
                last = f"{1 - ratio.value:.0%} ± {ratio.error:.0%}"
                thesis = {"direct": "50 to 60 %", "whole": "40 to 50 %"}[part] if name == "halton" else ""
            record.add(name, part, f"{track.mean[-1]:.3g}", *cells, last, thesis)
    record.notes += [
        "direct: emission and first shot alone, against the same by many rays; whole: as many global lines after it",
        f"noise of the references: {exact.direct_noise:.2g} (direct), {exact.noise:.2g} (whole)",
    ]
    return record
