"""Direct light of suns on patches in files, which are written atomically."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.core import OptionError, checked_path
from etendue.film import replacing
from etendue.formats import NetcdfFile, netcdf_library, save_arrays

from ..errors import RadiosityError
from ..factors.formfactors import numbers_of
from ..factors.groups import row_names
from ..sunlight import Sunlight
from .factorfiles import no_factors

_SUFFIXES = (".csv", ".npz", ".nc")
#: Bytes of a line of a table, and its largest size.
_LINE, _MOST_TEXT = 60.0, 4e9


def check_sun_file(path: str | os.PathLike[str]) -> Path:
    """The path of a file of :func:`save_sunlight`. Raises :class:`OptionError` for another suffix,
    :class:`etendue.core.BackendError` for netCDF without its library."""
    checked = checked_path(path, "a file of sunlight")
    if checked.suffix.lower() not in _SUFFIXES:
        raise OptionError(f"sunlight is written as {', '.join(_SUFFIXES)}, not as '{checked.name}'; change the name")
    if checked.suffix.lower() == ".nc":
        netcdf_library(checked)
    return checked


def save_sunlight(path: str | os.PathLike[str], found: Sunlight, *, metadata: Mapping[str, Any] | None = None) -> None:
    """Write the direct light of suns.

    ``.csv``: a line for each sun and patch: ``sun`` and ``patch`` by name, ``sunlit``, ``error``, ``irradiance``.
    ``.npz``: ``sunlit``, ``error``, ``cosine``, ``irradiance`` (n, k), ``suns``, ``sun_directions``, ``direct_normal``,
        ``areas``, ``face``, ``label``, ``name``, and ``metadata`` (JSON).
    ``.nc``: the same by ``patch`` and ``sun``, with units.

    Raises :class:`RadiosityError` for a table of more than 4 GB, :class:`etendue.core.OutputError` if the file cannot
    be written, and as :func:`check_sun_file`.
    """
    place, suns, areas = check_sun_file(path), found.suns, found.patches.areas
    by_sun = {"sunlit": found.sunlit, "error": found.error, "cosine": found.cosine, "irradiance": found.irradiance}
    if place.suffix.lower() == ".csv":
        _write_table(place, found)
    elif place.suffix.lower() == ".npz":
        known = {"suns": suns.names, "sun_directions": suns.directions, "direct_normal": suns.direct_normal}
        save_arrays(place, {**by_sun, **known, "areas": areas, **numbers_of(found.patches)}, metadata)
    else:
        file = NetcdfFile("Direct light of suns on patches of surfaces", metadata)
        shares = {"sunlit": "share of the patch that is lit", "error": "standard error of the lit share"}
        shares["cosine"] = "area of the patch projected along the rays, over its area"
        for name, about in shares.items():
            file.add(name, "patch sun", by_sun[name], about, "1")
        file.add("irradiance", "patch sun", found.irradiance, "direct irradiance, mean over the patch", "W m-2")
        file.add("direct_normal", "sun", suns.direct_normal, "irradiance normal to the rays of the sun", "W m-2")
        for axis, (letter, way) in enumerate(zip("xyz", ("east", "north", "up"), strict=True)):
            file.add(f"sun_{letter}", "sun", suns.directions[:, axis], f"unit vector towards the sun, {way}", "1")
        file.add_texts("sun", "sun sun_letter", suns.names, "name or time of the sun")
        file.add("area", "patch", areas, "area of the patch", "m2")
        file.add("face", "patch", found.patches.face, "number of the first face of the patch in its mesh, from 0")
        file.write(place)


def _write_table(path: Path, found: Sunlight) -> None:
    n, k = found.sunlit.shape
    if _LINE * n * k > _MOST_TEXT:
        raise RadiosityError(
            f"'{path}' would have {n * k} lines and {_LINE * n * k / 1e9:.3g} GB, which is of no use: write .npz or .nc"
        )
    names, irradiance = row_names(no_factors(found.patches)).tolist(), found.irradiance
    with replacing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("sun", "patch", "sunlit", "error", "irradiance"))
        for j, sun in enumerate(found.suns.names):
            columns = (found.sunlit[:, j], found.error[:, j], irradiance[:, j])
            writer.writerows(
                (sun, name, *(f"{value:.7g}" for value in row))
                for name, *row in zip(names, *(column.tolist() for column in columns), strict=True)
            )
