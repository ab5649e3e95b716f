"""The four ways to draw a global line (section 3.4, table 3.2 of the thesis)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from etendue.radiosity import GENERATORS, Bundles, LineGenerator, RayScene, SpherePairs

from .. import plotting
from ..measuring import Record
from ..options import Out, Seeds
from .drivers import DRIVERS, INDEPENDENT
from .options import BUNDLES, GOOD, OUT, RAYS, Detail, Least, Lines, Rays, ReferenceBundles, Scenes, Sequences
from .references import Reference, mean_squared_error, opened
from .sweeping import Task, half_and_half, marks, sweep

#: Slopes of table 3.2, of the sequence that was best with each.
_THESIS = {"sphere-pairs": -1.12, "box-walls": -1.04, "great-circle": -1.02, "bundles": -0.96}
#: Lines of a bundle through the bounding sphere. Line by line, multipath takes no parallel ones that follow each other:
#: what a patch receives along one must leave along another direction.
_PER_BUNDLE = 1


def tasks(scene: RayScene, exact: Reference, names: list[str]) -> dict[tuple[str, str], Task]:
    """The whole solution by (generator, sequence)."""
    patches = scene.patches

    def task(generator: LineGenerator, name: str) -> Task:
        return lambda count, seed: mean_squared_error(
            patches, half_and_half(scene, DRIVERS[name], count, seed, generator).radiosity, exact.radiosity
        )

    made = {
        name: Bundles(patches, _PER_BUNDLE) if kind is Bundles else kind(patches) for name, kind in GENERATORS.items()
    }
    return {(generator, name): task(made[generator], name) for generator in made for name in names}


def measure(
    scenes: Scenes = "four-chairs",
    sequences: Sequences = GOOD,
    lines: Lines = 1 << 17,
    least: Least = 1 << 12,
    seeds: Seeds = 10,
    detail: Detail = 1.0,
    rays: Rays = RAYS,
    bundles: ReferenceBundles = BUNDLES,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _scene(name, *opened(name, detail, rays, bundles), sequences, lines, least, seeds, out)


def _scene(
    title: str, scene: RayScene, exact: Reference, names: list[str], lines: int, least: int, seeds: int, out: Path
) -> Record:
    """Errors and slopes of every generator with every sequence."""
    tracks = sweep(tasks(scene, exact, names), marks(lines, least), seeds)
    plain = tracks[SpherePairs.name, INDEPENDENT]
    # As in the thesis, each generator with the sequence that is best with it.
    best = {generator: min(names, key=lambda name: tracks[generator, name].mean[-1]) for generator in GENERATORS}
    shown = [(SpherePairs.name, INDEPENDENT), *best.items()]
    curves = {", ".join(key): tracks[key].points for key in shown}
    axes = "local and as many global lines", "mean squared error of the radiosity"
    plotting.save(out / f"generators-{title}.svg", curves, title, *axes, 1.0)
    last = min(4, len(plain.lines))
    record = Record(
        f"Generators, {title}, {len(scene.patches)} patches, {lines} local and {lines} global lines, {seeds} seeds",
        ("", "sequence", "MSE", f"to independent sphere pairs, last {last}", "slope over lines", "seconds", "thesis"),
    )
    for (generator, name), track in tracks.items():
        thesis = "-1.00" if name == INDEPENDENT else f"best {_THESIS[generator]:.2f}"
        cells = f"{track.mean[-1]:.3g}", str(track.ratio(plain, last)), str(track.slope())
        record.add(generator, name, *cells, f"{track.seconds[:, -1].mean():.2f}", thesis)
    least_error = min(track.mean[-1] for track in tracks.values())
    record.notes += [
        "multipath line by line after a first shot; bundles of one line, so that each has a direction of its own",
        f"slopes from {plain.lines[0]:.0f} to {plain.lines[-1]:.0f} lines; standard errors from the seeds",
        f"noise of the reference: {exact.noise:.2g}, {exact.noise / least_error:.1%} of the least error here",
    ]
    return record
