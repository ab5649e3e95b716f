"""``python -m benchmarks [COMMAND]``; alone, all of them. ``--help`` lists the commands."""

from __future__ import annotations

import re
from typing import Annotated, cast, get_args

import typer

from etendue import methods as known
from etendue.cli.options import parse_pairs, parse_size
from etendue.core import EtendueError
from etendue.radiosity import Backend

from . import choice as choice_of_auto
from . import cost as cost_of_a_pass
from . import densities, exchanges, fresh, integrals, mitsuba_path, neighbours, sequences, view_factors
from . import guided as guiding
from . import quality as quality_over_time
from . import rays as ray_casting
from . import renders as short_renders
from .measuring import Record
from .options import Rounds, Size, Variant, WarmUp, begin, named, words

app = typer.Typer(
    help="Speed, memory and quality of the methods. Run on an idle machine; without a command all are run (an hour).",
    add_completion=False,
    pretty_exceptions_enable=False,
)
Methods = Annotated[str, typer.Option(help="Names, separated by commas.", metavar="NAMES")]
Keep = Annotated[bool, typer.Option("--record", help="Append the tables to benchmarks/RESULTS.md.")]


def _publish(variant: str, keep: bool, *records: Record) -> None:
    for record in records:
        record.publish(variant, keep)


def _names(text: str) -> list[str]:
    """Names of methods; raises the error of the first that does not exist."""
    return [known.get(name).name for name in words(text)]


@app.command()
def cost(
    methods: Annotated[
        str,
        typer.Option(
            help="Names, separated by commas; vcm:split_layers=true is vcm with that setting.",
            metavar="NAME[:SETTING=VALUE]...,...",
        ),
    ] = "path,bpt,vcm,sppm",
    size: Size = "512x512",
    rounds: Rounds = 11,
    warm_up: WarmUp = 2,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Seconds of a pass relative to Mitsuba's path at one sample per pixel, interleaved; and what a setting costs."""
    # A comma before a number is one of a setting: vcm:radii=0.5,2
    variants = [cost_of_a_pass.Variant.parse(text) for text in re.split(r"\s*,\s*(?=[a-z])", methods.strip())]
    chosen = begin(variant)
    _publish(chosen, record, cost_of_a_pass.measure(variants, parse_size(size), rounds, warm_up))


@app.command()
def renders(
    methods: Methods = "bpt,vcm",
    size: Size = "256x192",
    rounds: Rounds = 100,
    warm_up: WarmUp = 2,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Many pictures of one sample by mi.render, with what was prepared kept and made anew, interleaved."""
    chosen = begin(variant)
    _publish(chosen, record, short_renders.measure(_names(methods), parse_size(size), rounds, warm_up))


@app.command("first-pass")
def first_pass(
    methods: Methods = "path,bpt,vcm", size: Size = "512x512", variant: Variant = None, record: Keep = False
) -> None:
    """The first pass in a fresh process, with an empty and with a filled kernel cache."""
    chosen = begin(variant)
    _publish(chosen, record, fresh.first_pass(_names(methods), parse_size(size), chosen))


@app.command()
def memory(
    methods: Methods = "vcm",
    sizes: Annotated[str, typer.Option(help="Sizes, separated by commas.", metavar="WxH,...")] = "512x512,1920x1080",
    bound: Annotated[float | None, typer.Option(help="What --memory is given, in MB.", metavar="MB")] = None,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Peak memory of a fresh process."""
    chosen = begin(variant)
    wanted = [parse_size(text) for text in words(sizes)]
    limit = int(bound * 1e6) if bound else None
    _publish(chosen, record, fresh.memory(_names(methods), wanted, chosen, bound=limit))


@app.command()
def rays(
    methods: Methods = "path,bpt,vcm",
    size: Size = "512x512",
    rounds: Rounds = 9,
    warm_up: WarmUp = 2,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Share of ray casting: the rays of a pass are recorded and cast again."""
    chosen = begin(variant)
    _publish(chosen, record, ray_casting.measure(_names(methods), parse_size(size), rounds, warm_up))


@app.command()
def quality(
    scenes: Annotated[str, typer.Option(help="Names, separated by commas.", metavar="NAMES")] = ",".join(
        (quality_over_time.DEMO, *quality_over_time.PUBLIC)
    ),
    methods: Methods = "auto,path,light,sppm,bpt,bpm,vcm",
    size: Size = "512x512",
    time: Annotated[float, typer.Option(help="Seconds for each picture.")] = 60.0,
    seeds: Annotated[int, typer.Option(min=1, help="Pictures of each; the median counts.")] = 1,
    define: Annotated[
        list[str] | None, typer.Option("-D", help="A setting, or METHOD.NAME=VALUE.", metavar="NAME=VALUE")
    ] = None,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Error against a converged picture after a given time, for every method."""
    chosen = begin(variant)
    settings = parse_pairs(define, "-D")
    tables = quality_over_time.measure(words(scenes), _names(methods), parse_size(size), time, seeds, settings)
    _publish(chosen, record, *tables)


@app.command()
def choice(
    scenes: Annotated[str, typer.Option(help="Names, separated by commas; all by default.", metavar="NAMES")] = "",
    pixels: Annotated[int, typer.Option(min=1, help="Pixels of a picture, about.")] = 65536,
    time: Annotated[float, typer.Option(help="Seconds for each picture.")] = 30.0,
    seeds: Annotated[int, typer.Option(min=1, help="Pictures of each; the median counts.")] = 1,
    cold: Annotated[
        float, typer.Option(min=0.0, help="Seconds in fresh processes with an empty kernel cache; 0: left out.")
    ] = 5.0,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Error of auto after a given time, beside each of its candidates; its samples; and cold, beside path."""
    chosen = begin(variant)
    tables = choice_of_auto.measure(words(scenes), pixels, time, seeds, cold, chosen)
    _publish(chosen, record, *tables)


@app.command("mitsuba-path")
def beside_mitsuba(
    part: Annotated[str, typer.Option(help="samples, time or speed; all by default.")] = "",
    scenes: Annotated[str, typer.Option(help="Names, separated by commas.", metavar="NAMES")] = ",".join(
        mitsuba_path.SCENES
    ),
    filters: Annotated[str, typer.Option(help="Filters, separated by commas.", metavar="NAMES")] = ",".join(
        mitsuba_path.FILTERS
    ),
    pixels: Annotated[int, typer.Option(min=1, help="Pixels of a picture, about.")] = 16384,
    spp: Annotated[int, typer.Option(min=16, help="Samples a pixel of `samples`.")] = 64,
    time: Annotated[float, typer.Option(help="Seconds for each picture of `time`.")] = 30.0,
    seeds: Annotated[int, typer.Option(min=1, help="Pictures of each; the median counts.")] = 3,
    sides: Annotated[str, typer.Option(help="Of `speed`: the root of the number of pixels.")] = "128,256,512,1024",
    rounds: Rounds = 7,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Error and samples a second of path, beside Mitsuba's own path."""
    chosen = begin(variant)
    names = words(scenes)
    if part in ("", "samples"):
        _publish(chosen, record, mitsuba_path.equal_samples(names, words(filters), pixels, spp, seeds))
    if part in ("", "time"):
        _publish(chosen, record, mitsuba_path.equal_time([*names, "veach-bidir"], pixels, time, seeds))
    if part in ("", "speed"):
        for name in names:
            _publish(chosen, record, mitsuba_path.speed(name, [int(side) for side in words(sides)], rounds))


@app.command()
def guided(
    scenes: Annotated[str, typer.Option(help="Names, separated by commas.", metavar="NAMES")] = ",".join(
        guiding.SCENES
    ),
    size: Size = "512x512",
    time: Annotated[float, typer.Option(help="Seconds for each picture.")] = 30.0,
    seeds: Annotated[int, typer.Option(min=1, help="Pictures of each; the median counts.")] = 3,
    define: Annotated[list[str] | None, typer.Option("-D", help="A setting of guided.", metavar="NAME=VALUE")] = None,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Error times time of guided path tracing, beside Mitsuba's path and ours."""
    chosen = begin(variant)
    tables = guiding.measure(words(scenes), parse_size(size), time, seeds, parse_pairs(define, "-D"))
    _publish(chosen, record, *tables)


@app.command()
def knn(
    points: Annotated[int, typer.Option(min=1, help="Points in the tree.")] = 1_000_000,
    k: Annotated[int, typer.Option("-k", min=1, help="Neighbours of a query.")] = 50,
    size: Size = "512x512",
    rounds: Rounds = 7,
    warm_up: WarmUp = 1,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Build a kd-tree and find k nearest neighbours, beside scipy's cKDTree."""
    chosen = begin(variant)
    if k > points:
        raise SystemExit(f"-k {k} is more than there are points ({points})")
    _publish(chosen, record, neighbours.measure(points, k, parse_size(size), rounds, warm_up))


@app.command()
def points(
    count: Annotated[int, typer.Option(min=1, max=1 << 31, help="Points of a round.")] = 1 << 27,
    dimension: Annotated[int, typer.Option("-d", min=1, max=1024, help="Coordinates of a point.")] = 4,
    rounds: Rounds = 7,
    warm_up: WarmUp = 2,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Points of sequences, made and reduced on the device, beside scipy's qmc."""
    chosen = begin(variant)
    _publish(chosen, record, sequences.measure(count, dimension, rounds, warm_up))


@app.command()
def integration(
    evaluations: Annotated[str, typer.Option(help="An iteration's, separated by commas.", metavar="N,...")] = (
        "1000,10000,100000"
    ),
    seeds: Annotated[int, typer.Option(min=2, help="Runs whose errors are averaged.")] = 40,
    speed: Annotated[int, typer.Option(min=1000, help="Evaluations of an iteration that is timed.")] = 1_000_000,
    rounds: Rounds = 7,
    warm_up: WarmUp = 2,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """The VEGAS-derived integrator beside the vegas package: errors, and evaluations a second."""
    chosen = begin(variant)
    counts = [int(word) for word in words(evaluations)]
    tables = (integrals.errors(counts, seeds), integrals.speed(speed, rounds, warm_up))
    _publish(chosen, record, *tables)


@app.command()
def density(
    count: Annotated[int, typer.Option(min=1000, help="Samples, and queries.")] = 1_000_000,
    near: Annotated[int, typer.Option(min=1, max=999, help="Samples within a kernel on average, and k.")] = 50,
    rounds: Rounds = 5,
    warm_up: WarmUp = 1,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Density estimates in the plane beside scipy's gaussian_kde."""
    chosen = begin(variant)
    _publish(chosen, record, densities.measure(count, near, rounds, warm_up))


@app.command()
def radiosity(
    cells: Annotated[
        str, typer.Option(help="Along an edge of the room, separated by commas.", metavar="N,...")
    ] = "20,107",
    bundles: Annotated[int, typer.Option(min=1, help="Bundles of parallel lines.")] = 1024,
    lines: Annotated[
        float | None, typer.Option(min=1, help="Lines of a bundle; four for each patch by default, 16384 at least.")
    ] = None,
    backends: Annotated[
        str, typer.Option(help="auto, compiled (Numba), drjit, separated by commas.", metavar="NAME,...")
    ] = "auto",
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """Segments of global lines: cast, replayed and solved in a second, and the error that they leave."""
    engines = cast("list[Backend]", named(backends, get_args(Backend), "backend"))
    chosen = begin(variant)
    _publish(chosen, record, exchanges.measure([int(word) for word in words(cells)], bundles, lines, engines))


@app.command("view-factors")
def view_factors_of_a_room(
    cells: Annotated[
        str, typer.Option(help="Along an edge of the room, separated by commas.", metavar="N,...")
    ] = "20,24",
    bundles: Annotated[int, typer.Option(min=1, help="Bundles of parallel lines.")] = 1024,
    lines: Annotated[float, typer.Option(min=1, help="Lines of a bundle.")] = 48000,
    peer_python: Annotated[
        str | None, typer.Option(help="A Python that has pyViewFactor 1.1.0.", metavar="PROGRAM")
    ] = None,
    view3d: Annotated[str | None, typer.Option("--view3d", help="The program of View3D.", metavar="PROGRAM")] = None,
    variant: Variant = None,
    record: Keep = False,
) -> None:
    """View factors by global lines, by pyViewFactor and by View3D: CPU time and errors."""
    chosen = begin(variant)
    sizes = [int(word) for word in words(cells)]
    _publish(chosen, record, view_factors.measure(sizes, bundles, lines, peer_python, view3d))


@app.callback(invoke_without_command=True)
def everything(context: typer.Context, variant: Variant = None, record: Keep = False) -> None:
    """Run every benchmark in turn."""
    if context.invoked_subcommand is None:
        cost(variant=variant, record=record)
        renders(variant=variant, record=record)
        first_pass(variant=variant, record=record)
        memory(variant=variant, record=record)
        rays(variant=variant, record=record)
        quality(variant=variant, record=record)
        choice(variant=variant, record=record)
        guided(variant=variant, record=record)
        knn(variant=variant, record=record)
        points(variant=variant, record=record)
        integration(variant=variant, record=record)
        density(variant=variant, record=record)
        radiosity(variant=variant, record=record)
        view_factors_of_a_room(variant=variant, record=record)


if __name__ == "__main__":
    try:
        app()
    except EtendueError as error:
        raise SystemExit(str(error)) from None
