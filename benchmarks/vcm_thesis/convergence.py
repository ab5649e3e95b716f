"""Convergence (tables 5.6 to 5.8 of the thesis): the error of VCM, BPT, BPM and PT over time, each given the same."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from .. import plotting
from ..measuring import Record
from ..options import Out, ReferenceSeconds, Seconds, Seeds, Size
from ..racing import ORDER, TRIM, Entrant, marks, order, race
from ..references import Reference
from .entrants import RADIUS, open_scene, the_four
from .options import ALL, OUT, SIZE, ReferenceMethod, ReferenceRadius, Roulette, Scenes
from .references import recipe


def measure(
    scenes: Scenes = ALL,
    size: Size = SIZE,
    seconds: Seconds = 20.0,
    seeds: Seeds = 3,
    roulettes: Roulette = "albedo",
    reference_seconds: ReferenceSeconds = 60.0,
    method: ReferenceMethod = "vcm",
    millimetres: ReferenceRadius = 5.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene and roulette."""
    for name in scenes:
        reference = recipe(name, method, millimetres).find(size, out, reference_seconds)
        for roulette in roulettes:
            yield _scene(name, size, seconds, seeds, out, reference, roulette)


def _scene(
    name: str, size: tuple[int, int], seconds: float, seeds: int, out: Path, reference: Reference, roulette: str
) -> Record:
    """A table of one scene: RMS at four times, and the order early and late."""
    times = marks(seconds)
    four = the_four(roulette=roulette)
    ours = Entrant("vcm, our settings", "vcm", {"radius": RADIUS, "radius_unit": "absolute", "direct_light": "all"})
    tracks = race(open_scene(name, size), [*four, ours], reference.image, times, range(seeds))
    plotting.save(
        out / f"convergence-{name}-{roulette}.svg", {k: plotting.over_time(v) for k, v in tracks.items()}, name
    )
    shown = [len(times) - 1 - k for k in (4, 2, 1, 0)]
    record = Record(
        f"Convergence, {name}, {size[0]}x{size[1]}, {seconds:g} s, roulette by {roulette}",
        ("", "passes", *(f"RMS at {times[k]:g} s" for k in shown), "all pixels"),
    )
    for label, points in tracks.items():
        end = points[-1]
        record.add(label, f"{end.passes:.0f}", *(points[k].text for k in shown), f"{end.untrimmed:.4f}")
    early, late = shown[0], shown[-1]
    compared = {entrant.label: tracks[entrant.label] for entrant in four}
    record.notes += [
        f"best first, at {times[early]:g} s: {order(compared, early)}; at {times[late]:g} s: {order(compared, late)}",
        ORDER,
        _conditions(seeds),
        f"RMS of the difference of luminance, without the worst {TRIM:.1%} of the pixels; reference: {reference.note}",
    ]
    return record


def _conditions(seeds: int) -> str:
    return (
        f"the methods take turns on one scene, pass by pass, each for the same time of passes; root of the mean of "
        f"{seeds} seed{'s' if seeds > 1 else ''}; first radius {1000 * RADIUS:g} mm, alpha 2/3, as many light paths as "
        "pixels, vcm without merging at the first camera vertex; our settings: vcm's defaults with the same radius and "
        "direct_light=all, not in the order"
    )
