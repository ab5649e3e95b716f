"""The radius (tables 5.10, 5.11), light paths against radius (5.9), and several radii in one run (section 5.5)."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path

from etendue.core import Replica

from .. import plotting
from ..measuring import Record, interleaved, spread
from ..options import Out, ReferenceSeconds, Rounds, Seconds, Seeds, Size, WarmUp
from ..racing import ORDER, TRIM, Entrant, marks, race
from ..references import Reference
from .entrants import RADIUS, ROULETTE, merging, open_scene
from .options import OUT, SIZE, SPECULAR, ReferenceMethod, ReferenceRadius, Roulette, Scenes
from .references import recipe

#: The radii of the sweep, in millimetres, and the one for the photons.
RADII = (5.0, 12.0, 25.0)
PHOTON_RADIUS = 0.0125


def radius(
    scenes: Scenes = "living-room",
    size: Size = SIZE,
    seconds: Seconds = 20.0,
    seeds: Seeds = 3,
    roulettes: Roulette = "albedo",
    reference_seconds: ReferenceSeconds = 60.0,
    method: ReferenceMethod = "vcm",
    millimetres: ReferenceRadius = 5.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """Passes and RMS for each scene."""
    for name in scenes:
        reference = recipe(name, method, millimetres).find(size, out, reference_seconds)
        for roulette in roulettes:
            yield from _radius(name, size, seconds, seeds, out, reference, roulette)


def _radius(
    name: str, size: tuple[int, int], seconds: float, seeds: int, out: Path, reference: Reference, roulette: str
) -> list[Record]:
    """Passes and RMS at growing times, for each radius with and without merging at the first camera vertex."""
    entrants = [
        Entrant(
            f"{r:g} mm, {'on' if first else 'off'}",
            "vcm",
            merging("vcm", r / 1000.0, merge_first=first, **ROULETTE[roulette]),
        )
        for r in RADII
        for first in (True, False)
    ]
    times = marks(seconds, 6)
    tracks = race(open_scene(name, size), entrants, reference.image, times, range(seeds))
    plotting.save(out / f"radius-{name}.svg", {k: plotting.over_time(v) for k, v in tracks.items()}, f"{name}, radius")
    what = f"{name}, {size[0]}x{size[1]}, {seconds:g} s, roulette by {roulette}"
    passes = Record(f"Radius sweep: passes, {what}", ("own seconds", *tracks))
    errors = Record(f"Radius sweep: RMS of luminance, {what}", ("own seconds", *tracks))
    for k, at in enumerate(times):
        passes.add(f"{at:g}", *(f"{points[k].passes:.0f}" for points in tracks.values()))
        errors.add(f"{at:g}", *(points[k].text for points in tracks.values()))
    errors.add(f"{seconds:g}, all pixels", *(f"{points[-1].untrimmed:.4f}" for points in tracks.values()))
    costs = []
    for r in RADII:
        on, off = (tracks[f"{r:g} mm, {word}"][-1] for word in ("on", "off"))
        costs.append(f"{r:g} mm {1.0 - (on.passes / on.seconds) / (off.passes / off.seconds):+.1%}")
    read = "on, off: merging at the first camera vertex; passes that it costs (-: gains): "
    passes.notes.append(read + ", ".join(costs))
    errors.notes += _errors(seeds, reference)
    return [passes, errors]


def photons(
    scenes: Scenes = "living-room",
    size: Size = SIZE,
    seconds: Seconds = 30.0,
    seeds: Seeds = 3,
    roulettes: Roulette = "albedo",
    reference_seconds: ReferenceSeconds = 60.0,
    method: ReferenceMethod = "vcm",
    millimetres: ReferenceRadius = 5.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        reference = recipe(name, method, millimetres).find(size, out, reference_seconds)
        for roulette in roulettes:
            yield _photons(name, size, seconds, seeds, out, reference, roulette)


def _photons(
    name: str, size: tuple[int, int], seconds: float, seeds: int, out: Path, reference: Reference, roulette: str
) -> Record:
    """More light paths against a larger radius, at equal time: both have the same weights for merging."""
    millimetres = 1000.0 * PHOTON_RADIUS
    entrants = [
        Entrant(label, "vcm", merging("vcm", r, merge_first=False, **ROULETTE[roulette]) | {"light_paths": paths})
        for label, r, paths in (
            (f"a: {millimetres:g} mm, n = pixels", PHOTON_RADIUS, 1.0),
            (f"b: {millimetres:g} mm, n = 4 x pixels", PHOTON_RADIUS, 4.0),
            (f"c: {2 * millimetres:g} mm, n = pixels", 2 * PHOTON_RADIUS, 1.0),
        )
    ]
    times = marks(seconds, 6)
    tracks = race(open_scene(name, size), entrants, reference.image, times, range(seeds))
    plotting.save(
        out / f"photons-{name}.svg", {k: plotting.over_time(v) for k, v in tracks.items()}, f"{name}, photons"
    )
    record = Record(
        f"Light paths and radius, {name}, {size[0]}x{size[1]}, {seconds:g} s, roulette by {roulette}",
        ("", "passes", *(f"RMS at {at:g} s" for at in times[1:]), "all pixels"),
    )
    for label, points in tracks.items():
        end = points[-1]
        record.add(label, f"{end.passes:.0f}", *(p.text for p in points[1:]), f"{end.untrimmed:.4f}")
    record.notes += _errors(seeds, reference)
    return record


def _errors(seeds: int, reference: Reference) -> list[str]:
    """How the errors of a table are to be read."""
    what = f"RMS without the worst {TRIM:.1%} of the pixels, root of the mean of {seeds} seed{'s' if seeds > 1 else ''}"
    return [f"{what}; reference: {reference.note}", ORDER]


def radii(names: Scenes = SPECULAR, size: Size = SIZE, rounds: Rounds = 9, warm_up: WarmUp = 2) -> Record:
    """What a pass costs that makes a picture for one, two and three radii."""
    record = Record(
        f"Several radii in one run, {size[0]}x{size[1]}",
        ("", "one s", "two / one", "three / one", "largest alone s", "three / largest alone"),
    )
    for name in names:
        problem = open_scene(name, size)
        # The grid is searched at the largest radius, so a run with that one alone is the fair measure.
        wanted = {
            "one": merging("vcm", RADIUS),
            "two": merging("vcm", RADIUS, radii="0.5"),
            "three": merging("vcm", RADIUS, radii="0.5,2"),
            "largest": merging("vcm", 2 * RADIUS),
        }
        tasks = {
            key: Replica(Entrant(key, "vcm", settings).prepared(problem, 0), 0).step for key, settings in wanted.items()
        }
        wall = {key: [c.wall for c in clocks] for key, clocks in interleaved(tasks, rounds, warm_up).items()}

        def ratio(a: str, b: str, wall: dict[str, list[float]] = wall) -> str:
            return spread([x / y for x, y in zip(wall[a], wall[b], strict=True)], ".3f")

        one, largest = (f"{statistics.median(wall[key]):.3f}" for key in ("one", "largest"))
        record.add(name, one, ratio("two", "one"), ratio("three", "one"), largest, ratio("three", "largest"))
    record.notes += [
        f"radii: {1000 * RADIUS:g} mm; with {500 * RADIUS:g} mm; with {500 * RADIUS:g} and {2000 * RADIUS:g} mm",
        f"ratios: median (min … max) of {rounds} rounds in turn after {warm_up}",
        "thesis: below 0.3 % of the time",
    ]
    return record
