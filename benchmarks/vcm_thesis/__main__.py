"""``python -m benchmarks.vcm_thesis COMMAND``; without a command all of them, about an hour."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.cli.options import parse_size
from etendue.core import EtendueError, OptionError

from ..measuring import Record
from ..options import Rounds, Size, Variant, WarmUp, begin, named, words
from . import convergence as error_over_time
from . import correctness as against_path
from . import profile as profiles
from . import references, sweeps
from .scenes import SCENES

RESULTS = Path(__file__).resolve().parent / "RESULTS.md"

app = typer.Typer(
    help="The experiments of the thesis on vertex connection and merging. Run on an idle machine.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
Scenes = Annotated[str, typer.Option("--scene", help="Names, separated by commas.", metavar="NAMES")]
Time = Annotated[float, typer.Option(min=0.01, help="Seconds for each method or setting.")]
Seeds = Annotated[int, typer.Option(min=1, help="Runs of each; their mean square counts.")]
ReferenceTime = Annotated[float, typer.Option(min=0.01, help="Seconds for a reference that is not there yet.")]
ReferenceMethod = Annotated[
    str, typer.Option("--reference-method", help="What makes the references: vcm, bpt, path.", metavar="NAME")
]
ReferenceRadius = Annotated[
    float, typer.Option("--reference-radius", min=0.001, help="First radius of references by vcm.", metavar="MM")
]
Out = Annotated[Path, typer.Option(help="Folder for references and plots.")]
Keep = Annotated[bool, typer.Option("--record", help="Append the tables to benchmarks/vcm_thesis/RESULTS.md.")]

_ALL = ",".join(SCENES)
_SPECULAR = ",".join(name for name in SCENES if name != "diffuse")
_OUT = Path("thesis-output")
_SIZE = "320x240"


def _publish(variant: str, keep: bool, *records: Record) -> None:
    for record in records:
        record.publish(variant, keep, RESULTS)


def _names(text: str) -> list[str]:
    """Names of scenes; raises :class:`OptionError` for one that does not exist."""
    return named(text, SCENES, "scene")


def _lengths(text: str) -> list[float]:
    """Positive numbers between commas; raises :class:`OptionError` for anything else."""
    try:
        found = [float(word) for word in words(text)]
    except ValueError:
        found = []
    if not found or not all(0.0 < length < float("inf") for length in found):
        raise OptionError(f"option '--radius' takes millimetres, separated by commas, not '{text}'")
    return found


@app.command()
def reference(
    scene: Scenes = _ALL,
    size: Size = _SIZE,
    time: Time = 60.0,
    reference_method: ReferenceMethod = "vcm",
    reference_radius: ReferenceRadius = 5.0,
    out: Out = _OUT,
    variant: Variant = None,
) -> None:
    """Render the references anew, each for --time seconds, and keep them in --out."""
    begin(variant)
    record = Record(f"References, {size}, {time:g} s", ("", "noise (RMS of luminance)", "made by"))
    for name in _names(scene):
        made = references.recipe(name, reference_method, reference_radius).make(parse_size(size), out, time)
        record.add(name, f"{made.noise:.5f}", made.note)
    record.publish("", False)


@app.command()
def correctness(
    scene: Scenes = "diffuse",
    size: Size = _SIZE,
    passes: Annotated[int, typer.Option(min=4, help="Passes of each method.")] = 128,
    seeds: Annotated[int, typer.Option(min=1, help="Independent runs; the tests need two.")] = 5,
    radius: Annotated[str, typer.Option(help="First radii of vcm in millimetres.", metavar="MM[,MM...]")] = "1,12",
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """VCM and BPT against path tracing: does the difference fall as noise does, and has it structure? Ten minutes."""
    chosen = begin(variant)
    millimetres = _lengths(radius)
    for name in _names(scene):
        _publish(chosen, record, *against_path.measure(name, parse_size(size), passes, seeds, millimetres, out))


@app.command()
def convergence(
    scene: Scenes = _ALL,
    size: Size = _SIZE,
    time: Time = 20.0,
    seeds: Seeds = 3,
    reference_time: ReferenceTime = 60.0,
    reference_method: ReferenceMethod = "vcm",
    reference_radius: ReferenceRadius = 5.0,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """The error of VCM, BPT, BPM and PT over time, and their order early and late."""
    chosen = begin(variant)
    for name in _names(scene):
        found = references.recipe(name, reference_method, reference_radius).find(parse_size(size), out, reference_time)
        table = error_over_time.measure(name, parse_size(size), time, seeds, out, found)
        _publish(chosen, record, table)


@app.command()
def profile(
    scene: Scenes = _ALL,
    size: Size = _SIZE,
    time: Annotated[float, typer.Option(help="Seconds that the passes are counted for.")] = 60.0,
    rounds: Rounds = 9,
    warm_up: WarmUp = 2,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """What a pass of VCM is made of: times, path lengths, connections, photons, rays."""
    chosen = begin(variant)
    _publish(chosen, record, profiles.measure(_names(scene), parse_size(size), time, rounds, warm_up))


@app.command()
def radius(
    scene: Scenes = "living-room",
    size: Size = _SIZE,
    time: Time = 20.0,
    seeds: Seeds = 3,
    reference_time: ReferenceTime = 60.0,
    reference_method: ReferenceMethod = "vcm",
    reference_radius: ReferenceRadius = 5.0,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Radii of 5, 12 and 25 mm, with and without merging at the first camera vertex."""
    chosen = begin(variant)
    for name in _names(scene):
        found = references.recipe(name, reference_method, reference_radius).find(parse_size(size), out, reference_time)
        _publish(chosen, record, *sweeps.radius(name, parse_size(size), time, seeds, out, found))


@app.command()
def photons(
    scene: Scenes = "living-room",
    size: Size = _SIZE,
    time: Time = 30.0,
    seeds: Seeds = 3,
    reference_time: ReferenceTime = 60.0,
    reference_method: ReferenceMethod = "vcm",
    reference_radius: ReferenceRadius = 5.0,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Four times the light paths against twice the radius, at equal time."""
    chosen = begin(variant)
    for name in _names(scene):
        found = references.recipe(name, reference_method, reference_radius).find(parse_size(size), out, reference_time)
        _publish(chosen, record, sweeps.photons(name, parse_size(size), time, seeds, out, found))


@app.command()
def radii(
    scene: Scenes = _SPECULAR,
    size: Size = _SIZE,
    rounds: Rounds = 9,
    warm_up: WarmUp = 2,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """What further radii in the same run cost."""
    chosen = begin(variant)
    _publish(chosen, record, sweeps.radii(_names(scene), parse_size(size), rounds, warm_up))


@app.callback(invoke_without_command=True)
def everything(context: typer.Context, out: Out = _OUT, variant: Variant = None, record: Keep = False) -> None:
    """Run every experiment in turn, with the default settings."""
    if context.invoked_subcommand is None:
        reference(out=out, variant=variant)
        correctness(out=out, variant=variant, record=record)
        convergence(out=out, variant=variant, record=record)
        profile(variant=variant, record=record)
        radius(out=out, variant=variant, record=record)
        photons(out=out, variant=variant, record=record)
        radii(variant=variant, record=record)


if __name__ == "__main__":
    try:
        app()
    except EtendueError as error:
        raise SystemExit(str(error)) from None
