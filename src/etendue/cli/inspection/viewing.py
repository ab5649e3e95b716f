"""The command `view`: a scene live in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from etendue.core import OptionError, SceneError

from .. import options as opt
from ..console import error_console, note, say
from ..settings import settings_in

if TYPE_CHECKING:
    from etendue.viewer import Asked


def view(
    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML, a bundled scene, or a picture (.exr, .png ...).", metavar="SCENE")
    ],
    method: opt.Method = None,
    define: opt.Define = None,
    size: opt.PictureSize = None,
    sensor: opt.Sensor = 0,
    time: opt.Time = None,
    spp: opt.Spp = None,
    error: opt.Error = None,
    seed: opt.Seed = 0,
    param: opt.Param = None,
    memory: opt.Memory = None,
    variant: opt.Variant = None,
    threads: opt.Threads = None,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen at; 0.0.0.0 for all of this machine.", metavar="NAME")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", help="Port to listen at; 0 for any that is free.", min=0, max=65535, metavar="N")
    ] = 0,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-origin",
            help="Answer pages of this hub or proxy, such as https://hub.example.org, too; may be repeated.",
            metavar="URL",
        ),
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(
            "--address",
            help="Where a browser on another machine reaches the viewer, for the address that is printed.",
            metavar="URL",
        ),
    ] = None,
    radiosity: Annotated[
        Path | None, typer.Option("--radiosity", help="Show a solution of `etendue radiosity` in 3-D.", metavar="FILE")
    ] = None,
    tev: opt.Tev = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    debug: opt.Debug = False,
) -> int:
    """Show a scene live in the browser: move the camera, change lights and methods, compare, save; or a picture with
    its layers.

    The address has a token, without which nothing is answered. Ctrl-C ends the session.
    """
    from etendue import methods
    from etendue.products import DEFAULT, budget_of, choose_method
    from etendue.scene import locate
    from etendue.viewer import Asked, is_picture

    from ..running import choose_device

    settings = settings_in(define)
    parameters = opt.parse_pairs(param, "-P")
    console = error_console()
    if is_picture(scene) and not Path(scene).is_file():
        raise SceneError(f"there is no picture '{scene}'; check the path")
    found = scene if is_picture(scene) else locate(scene, lambda text: note(console, text))
    choose_device(variant, threads, scene=found)
    kind = methods.get(method or DEFAULT)
    if method is None and not is_picture(scene):
        with suppress(SceneError):  # reported by the page
            kind = choose_method(None, found, parameters)
    if not host.strip():
        raise OptionError("--host is an address of this machine, such as 127.0.0.1 or 0.0.0.0")
    if radiosity is not None and not radiosity.is_file():
        raise SceneError(f"there is no solution '{radiosity}'; make one by `etendue radiosity SCENE -o {radiosity}`")
    budget = budget_of(kind, opt.limits(time, error, spp=spp))
    asked = Asked(found, kind.name, settings, budget, size, sensor, parameters, memory, seed, solution=radiosity)
    return show(asked, host.strip(), port, not no_browser, tev, allow_origin or (), address)


def show(
    asked: Asked,
    host: str,
    port: int,
    in_browser: bool,
    tev: str | None = None,
    origins: Sequence[str] = (),
    address: str | None = None,
) -> int:
    """Run a session until a page or Ctrl-C ends it."""
    from etendue.viewer import Viewer

    console = error_console()
    with Viewer(asked, host, port, tev, origins, address) as viewer:
        note(console, "open this address in a browser; Ctrl-C ends the session:")
        say(viewer.url)
        if in_browser and not viewer.show():
            note(console, "no browser was found on this machine")
        try:
            while not viewer.wait(0.5):
                pass
        except KeyboardInterrupt:
            note(console, "ended")
    return 0
