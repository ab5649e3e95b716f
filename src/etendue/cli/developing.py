"""The command `develop`: a picture for a display from an OpenEXR file, denoised on request."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.core import OptionError, Result

from . import options as opt
from .console import error_console, note, say


def develop(
    picture: Annotated[Path, typer.Argument(help="OpenEXR file of étendue or Mitsuba.", metavar="PICTURE.exr")],
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "-o", "--output", help=".png, or .exr (linear); repeatable. By default PICTURE.png.", metavar="FILE"
        ),
    ] = None,
    denoise: Annotated[
        str | None,
        typer.Option(
            help="oidn, bilateral, guided, gaussian or nlm, or one for each component, as "
            "indirect=gaussian:radius=9,direct=none.",
            metavar="NAME|COMPONENT=NAME,...",
        ),
    ] = None,
    tone: opt.Tone = "srgb",
    exposure: opt.Exposure = "auto",
    false_colour: Annotated[
        bool, typer.Option("--false-colour", help="Luminance in cd/m^2 (683 lm/W) in false colours, with a legend.")
    ] = False,
    colour_range: opt.ColourRange = None,
    isolines: Annotated[
        bool, typer.Option("--isolines", help="With --false-colour: lines of equal luminance, at round values.")
    ] = False,
    layers: Annotated[
        str | None,
        typer.Option(
            help="Layers to denoise one by one and add up; by default those whose sum is the picture.",
            metavar="NAME,NAME...",
        ),
    ] = None,
    albedo: Annotated[str | None, typer.Option(help="Layer of the albedo.", metavar="LAYER")] = None,
    normal: Annotated[str | None, typer.Option(help="Layer of the normals.", metavar="LAYER")] = None,
    radius: Annotated[int, typer.Option(help="Radius of a filter's window, in pixels.", metavar="N")] = 5,
    strength: Annotated[float, typer.Option(help="How much is smoothed; 1 is usual.", metavar="X")] = 1.0,
    variant: opt.Variant = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Make a PNG of an OpenEXR picture: denoise it if asked, expose it, apply a tone curve, or use false colours.

    The file itself is not changed.
    """
    from etendue import display, film
    from etendue.products import check_files, check_picture, save_result

    display.check_tone(exposure, tone)
    outputs = output or [picture.with_suffix(".png")]
    if false_colour:
        if (tone, exposure) != ("srgb", "auto"):
            raise OptionError("false colours show luminance as it is: leave out --tone and --exposure")
        if linear := next((path for path in outputs if path.suffix.lower() == ".exr"), None):
            raise OptionError(f"false colours are written as .png, not as '{linear.name}'; leave out --false-colour")
        display.check_range(*(colour_range or ()))
    elif colour_range is not None or isolines:
        raise OptionError("--range and --isolines are of false colours; give --false-colour, too")
    filters = display.parse_filters(denoise, radius, strength)
    for path in outputs:
        check_picture(path)
        if path.absolute() == picture.absolute() or (path.exists() and picture.exists() and path.samefile(picture)):
            raise OptionError(f"'{path}' is the input, which is not changed; name another file by -o")
    check_files(outputs)
    read = film.read_exr(picture)
    film.refuse_bands(read.metadata, f"'{picture}'")
    if filters:
        from .running import choose_device

        choose_device(variant, threads)
    wanted = tuple(name.strip() for name in layers.split(",")) if layers is not None else ()
    console = error_console()
    settings = read.metadata.get("settings")
    has_network = any(one.name == "oidn" for one in filters.values())
    if has_network and isinstance(settings, dict) and settings.get("reconstruction") == "neighbours":
        text = "neighbouring pixels share samples, which oidn takes for structure unless the film's filter is a box"
        note(console, f"{text}: render with --for-denoising")
    if has_network and _merges(read.metadata):
        note(console, "oidn takes the blotches of merged photons for structure: nlm and bilateral suit them better")
    developed = display.develop(
        read.layers,
        denoise,
        components=wanted,
        albedo=albedo,
        normal=normal,
        radius=radius,
        strength=strength,
        tell=lambda text: note(console, text),
    )
    if false_colour:
        low, high = colour_range or (None, None)
        shown = display.luminance_picture(developed, low=low, high=high, lines=isolines)
        for path in outputs:
            display.write_png(path, shown)
            say(str(path))
        return 0
    if exposure == "auto":  # by the raw picture: a denoiser takes away bright pixels and spreads light into dark ones
        exposure = display.auto_exposure(display.develop(read.layers, components=wanted))
    how = {"from": str(picture), "denoise": denoise, "layers": layers, "radius": radius, "strength": strength}
    made = {"image": developed} | {name: layer for name, layer in read.layers.items() if name == film.ALPHA}
    for path in outputs:
        save_result(path, Result(made, {**read.metadata, "developed": how}), tone=tone, exposure=exposure)
        say(str(path))
    return 0


def _merges(metadata: Mapping[str, Any]) -> bool:
    """Whether the passes of a picture have merged photons."""
    return "merge_radius" in metadata and not str(metadata.get("chosen", "")).startswith(("path", "bpt"))
