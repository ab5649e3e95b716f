"""``python -m benchmarks.adaptive COMMAND``; without a command all of them, some twenty minutes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.cli.options import parse_size
from etendue.core import EtendueError

from ..measuring import Record
from ..options import Variant, begin, named, words
from . import convergence as errors
from . import sine as demonstration
from . import single as one_path
from .entrants import recipe
from .scenes import SCENES, SIZES

RESULTS = Path(__file__).resolve().parent / "RESULTS.md"

app = typer.Typer(
    help="The experiments of the thesis on adaptive path tracing. Run on an idle machine.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
Scenes = Annotated[str, typer.Option("--scene", help="Names, separated by commas.", metavar="NAMES")]
PictureSize = Annotated[str, typer.Option("--size", help="Of the pictures; by default the thesis's.", metavar="WxH")]
Samples = Annotated[int, typer.Option(min=16, help="Camera paths of a pixel.")]
Time = Annotated[float, typer.Option(min=0.01, help="Seconds for each method.")]
Seeds = Annotated[int, typer.Option(min=1, help="Runs of each; their mean square counts.")]
ReferenceTime = Annotated[float, typer.Option(min=0.01, help="Seconds for a reference that is not there yet.")]
Out = Annotated[Path, typer.Option(help="Folder for references, plots and pictures.")]
Keep = Annotated[bool, typer.Option("--record", help="Append the tables to benchmarks/adaptive/RESULTS.md.")]

_ALL = ",".join(SCENES)
_BOXES = "cornell,cornell-specular"
_OUT = Path("adaptive-output")


def _publish(variant: str, keep: bool, *records: Record) -> None:
    for record in records:
        record.publish(variant, keep, RESULTS)


def _names(text: str) -> list[str]:
    """Names of scenes; raises :class:`OptionError` for one that does not exist."""
    return named(text, SCENES, "scene")


def _size(name: str, text: str) -> tuple[int, int]:
    return parse_size(text or SIZES[name])


@app.command()
def reference(
    scene: Scenes = _ALL, size: PictureSize = "", time: Time = 60.0, out: Out = _OUT, variant: Variant = None
) -> None:
    """Render the references anew, each for --time seconds, and keep them in --out."""
    begin(variant)
    record = Record(f"References, {time:g} s", ("", "noise (RMS of luminance)", "made by"))
    for name in _names(scene):
        made = recipe(name).make(_size(name, size), out, time)
        record.add(name, f"{made.noise:.5f}", made.note)
    record.publish("", False)


@app.command()
def sine(
    samples: Annotated[str, typer.Option(help="Of an iteration, separated by commas.", metavar="N,...")] = (
        "100,1000,10000,100000"
    ),
    iterations: Annotated[int, typer.Option(min=2, help="The bins of the last one are judged.")] = 5,
    seeds: Seeds = 40,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """VEGAS on the sine: what smoothing and damping do, with few samples and with many."""
    chosen = begin(variant)
    counts = [int(word) for word in words(samples)]
    _publish(chosen, record, *demonstration.measure(counts, iterations, seeds, out))


@app.command()
def convergence(
    scene: Scenes = _ALL,
    size: PictureSize = "",
    samples: Samples = 2048,
    seeds: Seeds = 1,
    reference_time: ReferenceTime = 60.0,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """The errors of random path tracing, VEGAS and stratified over samples and time, and a sheet of pictures."""
    chosen = begin(variant)
    for name in _names(scene):
        table = errors.over_samples(name, _size(name, size), samples, seeds, out, reference_time)
        _publish(chosen, record, table)


@app.command("equal-time")
def equal_time(
    scene: Scenes = _ALL,
    size: PictureSize = "",
    time: Time = 20.0,
    seeds: Seeds = 1,
    reference_time: ReferenceTime = 60.0,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Their errors and pictures after the same time."""
    chosen = begin(variant)
    for name in _names(scene):
        _publish(chosen, record, errors.equal_time(name, _size(name, size), time, seeds, out, reference_time))


@app.command("warm-up")
def warm_up(
    scene: Scenes = _BOXES,
    size: PictureSize = "32x32",
    samples: Samples = 2048,
    seeds: Seeds = 1,
    reference_time: ReferenceTime = 20.0,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """From how many samples on VEGAS beats random paths, with a density for the image, and for each pixel."""
    chosen = begin(variant)
    for name in _names(scene):
        _publish(chosen, record, errors.warm_up(name, _size(name, size), samples, seeds, out, reference_time))


@app.command()
def single(
    scene: Scenes = _BOXES,
    size: PictureSize = "",
    samples: Samples = 256,
    seeds: Seeds = 3,
    reference_time: ReferenceTime = 60.0,
    out: Out = _OUT,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """One path an evaluation against one of each length, with and without learning."""
    chosen = begin(variant)
    for name in _names(scene):
        _publish(chosen, record, one_path.measure(name, _size(name, size), samples, seeds, out, reference_time))


@app.callback(invoke_without_command=True)
def everything(context: typer.Context, out: Out = _OUT, variant: Variant = None, record: Keep = False) -> None:
    """Run every experiment in turn, with the default settings."""
    if context.invoked_subcommand is None:
        reference(out=out, variant=variant)
        sine(out=out, variant=variant, record=record)
        convergence(out=out, variant=variant, record=record)
        equal_time(out=out, variant=variant, record=record)
        warm_up(out=out, variant=variant, record=record)
        single(out=out, variant=variant, record=record)


if __name__ == "__main__":
    try:
        app()
    except EtendueError as error:
        raise SystemExit(str(error)) from None
