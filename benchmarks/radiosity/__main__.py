"""``python -m benchmarks.radiosity COMMAND``; without a command all of them, some fifteen minutes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.core import EtendueError
from etendue.radiosity import RayScene

from ..measuring import Record
from ..options import Variant, begin, named, words
from . import estimators as form_factor_estimators
from . import generators as line_generators
from . import sequences as points
from .drivers import DRIVERS, INDEPENDENT
from .references import Reference, factor_reference
from .references import reference as make_reference
from .scenes import SCENES

RESULTS = Path(__file__).resolve().parent / "RESULTS.md"

app = typer.Typer(
    help="The experiments of the thesis on global lines. Run on an idle machine.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
Scenes = Annotated[str, typer.Option("--scene", help="Names, separated by commas.", metavar="NAMES")]
Sequences = Annotated[str, typer.Option("--sequences", help="Names, separated by commas.", metavar="NAMES")]
Lines = Annotated[int, typer.Option(min=2, help="Global lines, and as many local ones; halved again and again.")]
Least = Annotated[int, typer.Option(min=1, help="The fewest lines of them.")]
Seeds = Annotated[int, typer.Option(min=1, help="Runs of each; their mean square counts.")]
Detail = Annotated[float, typer.Option(min=0.01, help="Divides the size of the patches.")]
Rays = Annotated[int, typer.Option(min=1, help="Rays of half a reference.")]
ReferenceBundles = Annotated[int, typer.Option(min=1, help="Bundles of lines of half a reference.")]
Out = Annotated[Path, typer.Option(help="Folder for plots.")]
Keep = Annotated[bool, typer.Option("--record", help="Append the tables to benchmarks/radiosity/RESULTS.md.")]

_OUT = Path("global-lines-output")
_RAYS, _BUNDLES = 1 << 23, 4096
_EVERY = ",".join(DRIVERS)
_GOOD = f"{INDEPENDENT},halton,sobol"


def _publish(variant: str, keep: bool, *records: Record) -> None:
    for record in records:
        record.publish(variant, keep, RESULTS)


def _scenes(text: str) -> list[str]:
    """Names of scenes; raises :class:`OptionError` for one that does not exist."""
    return named(text, SCENES, "scene")


def _sequences(text: str) -> list[str]:
    """Names of sequences, independent numbers first, to which all others are compared."""
    return list(dict.fromkeys([INDEPENDENT, *named(text, DRIVERS, "sequence")]))


def _opened(name: str, detail: float, rays: int, bundles: int) -> tuple[RayScene, Reference]:
    scene = RayScene(SCENES[name](detail))
    return scene, make_reference(scene, rays, bundles)


@app.command()
def sequences(
    scene: Scenes = "six-cubes,room",
    sequences: Sequences = _EVERY,
    lines: Lines = 1 << 19,
    least: Least = 1 << 13,
    seeds: Seeds = 10,
    detail: Detail = 1.0,
    rays: Rays = _RAYS,
    bundles: ReferenceBundles = _BUNDLES,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """The error of multipath over lines and time with each sequence, and its slopes."""
    chosen, names = begin(variant), _sequences(sequences)
    for name in _scenes(scene):
        opened = _opened(name, detail, rays, bundles)
        _publish(chosen, record, *points.measure(name, *opened, names, lines, least, seeds, out))


@app.command()
def generators(
    scene: Scenes = "four-chairs",
    sequences: Sequences = _GOOD,
    lines: Lines = 1 << 17,
    least: Least = 1 << 12,
    seeds: Seeds = 10,
    detail: Detail = 1.0,
    rays: Rays = _RAYS,
    bundles: ReferenceBundles = _BUNDLES,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """The four generators of global lines, with independent numbers and with sequences."""
    chosen, names = begin(variant), _sequences(sequences)
    for name in _scenes(scene):
        opened = _opened(name, detail, rays, bundles)
        _publish(chosen, record, line_generators.measure(name, *opened, names, lines, least, seeds, out))


@app.command()
def direct(
    scene: Scenes = "six-cubes",
    sequences: Sequences = _GOOD,
    lines: Lines = 1 << 17,
    least: Least = 1 << 13,
    seeds: Seeds = 16,
    detail: Detail = 1.0,
    rays: Rays = _RAYS,
    bundles: ReferenceBundles = _BUNDLES,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """What sequences gain for direct light, and for the whole solution."""
    chosen, names = begin(variant), _sequences(sequences)
    for name in _scenes(scene):
        opened = _opened(name, detail, rays, bundles)
        _publish(chosen, record, points.direct(name, *opened, names, lines, least, seeds, out))


@app.command()
def estimators(
    scene: Scenes = "nine-cubes,test-one",
    lines: Annotated[
        str, typer.Option(help="Numbers, separated by commas.", metavar="N,...")
    ] = "50000,100000,500000,1000000",
    seeds: Seeds = 10,
    detail: Detail = 1.0,
    bundles: ReferenceBundles = _BUNDLES,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """The estimators F1 to F4 of form factors on the same lines."""
    chosen, counts = begin(variant), [int(word) for word in words(lines)]
    for name in _scenes(scene):
        opened = RayScene(SCENES[name](detail))
        exact, noise = factor_reference(opened.patches, bundles)
        table = form_factor_estimators.measure(name, opened, exact, noise, counts, seeds, out)
        _publish(chosen, record, table)


@app.callback(invoke_without_command=True)
def everything(context: typer.Context, out: Out = _OUT, variant: Variant = None, record: Keep = False) -> None:
    """Run every experiment in turn, with the default settings."""
    if context.invoked_subcommand is None:
        sequences(out=out, variant=variant, record=record)
        generators(out=out, variant=variant, record=record)
        direct(out=out, variant=variant, record=record)
        estimators(out=out, variant=variant, record=record)


if __name__ == "__main__":
    try:
        app()
    except EtendueError as error:
        raise SystemExit(str(error)) from None
