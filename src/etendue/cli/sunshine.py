"""`etendue sunlight`: the direct light of suns on the surfaces of a mesh or scene."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from etendue.core import OptionError, format_count, format_seconds

from . import options as opt
from .console import Steps, error_console, note, say
from .patches import Ids, LineSeed, MaxArea, More, Obstacles, Orient, Periodic, TwoSided, ZoneName, mesh_arguments

if TYPE_CHECKING:
    from etendue.lighting import Suns


def sunlight(
    mesh: Annotated[
        str,
        typer.Argument(
            help="Mesh (PLY, OBJ, STL, VTU, glTF and others), Mitsuba XML file, or bundled scene.", metavar="SCENE"
        ),
    ],
    suns: Annotated[
        Path | None,
        typer.Option(
            "--suns",
            help="Directions: a table (CSV) with a first line x,y,z (east, north, up) or azimuth,altitude in degrees, "
            "and perhaps direct_normal in W/m^2 and name.",
            metavar="FILE",
        ),
    ] = None,
    weather: Annotated[
        Path | None, typer.Option("--epw", help="Weather of a year: all hours with direct light.", metavar="FILE")
    ] = None,
    hours: Annotated[
        str | None,
        typer.Option("--hours", help="Of the weather: from hour A to before B, counted from 0.", metavar="A:B"),
    ] = None,
    latitude: Annotated[float | None, typer.Option("--latitude", help="Degrees north.", metavar="DEGREES")] = None,
    longitude: Annotated[float | None, typer.Option("--longitude", help="Degrees east.", metavar="DEGREES")] = None,
    at: Annotated[
        list[str] | None,
        typer.Option("--at", help="A time at that place, as 2024-06-21T12:00+02:00; repeatable.", metavar="TIME"),
    ] = None,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "-o",
            "--output",
            help=".csv (a line for each sun and patch), .npz, .nc (arrays); repeatable. By default sunlight.csv.",
            metavar="FILE",
        ),
    ] = None,
    up: Annotated[str, typer.Option("--up", help="Axis of the scene that is up: y or z.", metavar="AXIS")] = "z",
    north: opt.North = 0.0,
    lines: Annotated[
        float | None,
        typer.Option(
            "--lines", help="Of a bundle through the bounding sphere; four per patch in the mean.", metavar="N", min=1
        ),
    ] = None,
    ids: Ids = None,
    max_area: MaxArea = None,
    two_sided: TwoSided = False,
    more: More = None,
    obstacles: Obstacles = None,
    orient: Orient = None,
    zone: ZoneName = None,
    periodic: Periodic = None,
    seed: LineSeed = None,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the sunlit share of each patch, and its direct irradiance, for a list of suns: directions, times at a
    place, or the hours of a year.

    Shadows are those of all faces and sharp; nothing is reflected.
    """
    from etendue.products.patches import make_sunlight
    from etendue.radiosity import PatchSource

    from .lines import describe_patches

    began, files = time.perf_counter(), output or [Path("sunlight.csv")]
    asked = _suns(suns, weather, hours, (latitude, longitude), at)
    opt.Device(variant, threads).choose()
    source = PatchSource(
        source=mesh,
        max_area=max_area,
        mesh=mesh_arguments(ids, two_sided, orient, more, obstacles, zone, periodic),
        parameters=opt.parse_pairs(param, "-P"),
    )
    with Steps(error_console(), "reading") as steps:
        found = make_sunlight(
            source,
            asked,
            files,
            steps.update,
            lambda patches: describe_patches(source.name, patches),
            **{"up": up, "north": north, "lines": lines, "seed": seed or 0},
        )
    lit, facing = (found.patches.areas @ (found.cosine * shares) for shares in (found.sunlit, 1.0))
    share = f"{100 * lit.sum() / facing.sum():.3g} % of what faces them is lit" if facing.any() else "none is up"
    note(
        error_console(), f"{format_count(len(asked), 'sun')}, {share}; in {format_seconds(time.perf_counter() - began)}"
    )
    say("\n".join(map(str, files)))
    return 0


def _suns(
    table: Path | None,
    weather: Path | None,
    hours: str | None,
    place: tuple[float | None, float | None],
    at: list[str] | None,
) -> Suns:
    """The suns of the options. Raises :class:`OptionError` unless they are given in one way."""
    from etendue.lighting import Suns, read_epw

    given = [table is not None, weather is not None, bool(at) or place != (None, None)]
    if sum(given) != 1:
        raise OptionError("which suns? give one of --suns FILE, --epw FILE, or --latitude, --longitude and --at TIME")
    if hours is not None and weather is None:
        raise OptionError("--hours are those of the weather: give --epw FILE, or leave them out")
    if table is not None:
        return Suns.read(table)
    if weather is not None:
        year, chosen = read_epw(weather), None
        if hours is not None:
            found = re.fullmatch(r"(\d+):(\d+)", hours.strip())
            if found is None or not int(found[1]) < int(found[2]) <= len(year.times):
                raise OptionError(
                    f"--hours needs two of the numbers 0 to {len(year.times)}, as 4000:4024, not '{hours}'"
                )
            chosen = range(int(found[1]), int(found[2]))
        return Suns.of_weather(year, chosen)
    latitude, longitude = place
    if latitude is None or longitude is None or not at:
        raise OptionError("the sun at a place needs all of --latitude, --longitude and --at TIME")
    return Suns.at(latitude, longitude, at)
