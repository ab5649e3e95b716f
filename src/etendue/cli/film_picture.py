"""The command that develops samples on the film into pictures of any size."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.core import CheckpointError, OptionError

from . import options as opt
from .console import error_console, note, say


def film_picture(
    checkpoint: Annotated[
        Path, typer.Argument(help="Checkpoint of a picture by film_metropolis.", metavar="CHECKPOINT")
    ],
    output: opt.Output = None,
    size: opt.PictureSize = None,
    estimator: Annotated[
        str | None,
        typer.Option(help="histogram, kernel, variable or nearest; by default that of the run.", metavar="NAME"),
    ] = None,
    bandwidth: Annotated[
        float | None, typer.Option(help="Standard deviation of kernel and variable, in pixels.", metavar="X")
    ] = None,
    neighbours: Annotated[int | None, typer.Option(help="Samples of nearest.", metavar="N")] = None,
    inset: Annotated[
        float, typer.Option(help="Share of width and height that is left out at each side.", metavar="X")
    ] = 0.0,
    debug: opt.Debug = False,
) -> int:
    """Make pictures of any size from samples on the film, without new samples.

    They are in the checkpoint of `etendue render --method film_metropolis`, which `etendue resume` continues.
    """
    from etendue.core import Result
    from etendue.engine import Checkpoint
    from etendue.film import Development
    from etendue.methods import FilmMetropolis
    from etendue.products import Picture, save_result

    if not output:
        raise OptionError("name a picture, .exr or .png, by -o")
    outputs = Picture.of(output)
    saved = Checkpoint.read(checkpoint)
    if saved.method != FilmMetropolis.name:
        raise CheckpointError(
            f"{checkpoint} is a checkpoint of {saved.method}, whose pictures have one resolution: only samples of "
            f"{FilmMetropolis.name} can be developed"
        )
    settings: Any = FilmMetropolis.Settings.from_json(saved.settings)
    height, width = saved.measurement.sums["image"].shape[:2]
    how = Development(
        size or (width, height),
        estimator or settings.estimator,
        settings.bandwidth if bandwidth is None else bandwidth,
        settings.neighbours if neighbours is None else neighbours,
        inset,
    )
    picture = FilmMetropolis.picture(saved.measurement, how)
    made = {**vars(how), "size": list(how.size)}
    result = Result({"image": picture}, {"method": saved.method, "seed": saved.seed, "development": made})
    for path in outputs.pictures:
        save_result(path, result)
    count = int(saved.measurement.counters["film samples"])
    note(error_console(), f"{count} samples, {how.size[0]}x{how.size[1]}, {how.estimator}")
    say("\n".join(map(str, outputs.pictures)))
    return 0
