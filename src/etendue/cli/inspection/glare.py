"""`etendue glare`: discomfort glare of a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.table import Table

from etendue import film
from etendue.core import OptionError
from etendue.lighting import View, glare

from ..console import output_console, say

#: Sources that are listed, the strongest.
_LISTED = 20


def show_glare(picture: Path, view: View | None, illuminance: float | None, threshold: str, low_light: bool) -> int:
    """Show UGR, DGP and the sources of glare of a picture; without a ``view``, as its metadata tell. Raises
    :class:`OptionError`."""
    if picture.suffix.lower() != ".exr":
        raise OptionError(f"glare is computed from radiance, which is in an .exr, not in '{picture.name}'")
    relative = threshold.endswith("x")
    try:
        limit = float(threshold.removesuffix("x"))
    except ValueError:
        raise OptionError(
            f"--threshold is a luminance in cd/m^2, or 5x for 5 times the mean, not '{threshold}'"
        ) from None
    if view is None:
        view = _own_view(picture)
    pixels = film.read_image(picture)
    found = glare(
        pixels, view, vertical_illuminance=illuminance, threshold=limit, relative=relative, low_light=low_light
    )
    say(found.summary())
    if not found.sources:
        return 0
    table = Table("cd/m^2", "sr", "right", "up", "position", "share", box=None, pad_edge=False)
    weights = np.array([source.weight for source in found.sources])
    for source, share in zip(found.sources[:_LISTED], weights / weights.sum(), strict=False):
        x, y, z = source.direction
        right, up = np.rad2deg([np.arctan2(-x, z), np.arcsin(y)])
        numbers = f"{source.luminance:.0f} {source.solid_angle:.3g} {right:.1f} {up:.1f} {source.position_index:.2f}"
        table.add_row(*numbers.split(), f"{share:.1%}")
    output_console().print("", table)
    return 0


def _own_view(picture: Path) -> View:
    """The view of the camera that a picture's metadata describe. Raises :class:`OptionError`."""
    sensor = film.read_exr(picture).metadata.get("sensor")
    if not isinstance(sensor, dict):
        raise OptionError(
            f"'{picture.name}' does not tell its camera; give --view spherical, or --view perspective and --fov"
        )
    return View.of_sensor(sensor)
