"""View factors of sensors in files, and light for them from files of solutions. Files are written atomically."""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from etendue.core import Array, OptionError, checked_path
from etendue.film import replacing
from etendue.formats import save_arrays
from etendue.lighting import Meters
from etendue.surfaces import Patches

from ..errors import RadiosityError
from ..factors.groups import group_index, row_names
from ..pointfactors import PointFactors
from .factorfiles import no_factors

_SUFFIXES = (".csv", ".npz")
#: Shares beside those of patches: names of columns, and of the values.
_ENDS = {"sky": "sky", "ground": "ground", "backs": "dark"}
#: Bytes of a zero in a table, with its error, and the largest size of one.
_ZERO, _MOST_TEXT = 4.0, 4e9
#: Relative difference of areas, and distance of centres in radii, of patches that are the same.
_SAME = 1e-4


def check_point_file(
    path: str | os.PathLike[str], patches: Patches | None = None, meters: Meters | None = None, groups: bool = False
) -> Path:
    """The path of a file of :func:`save_point_factors`. Raises :class:`OptionError` for another suffix, and, if it is
    known what the file will have, :class:`RadiosityError` for a table of more than 4 GB, and for patches or groups with
    the names of other columns."""
    checked = checked_path(path, "a file of view factors of sensors")
    if checked.suffix.lower() not in _SUFFIXES:
        raise OptionError(
            f"view factors of sensors are written as {', '.join(_SUFFIXES)}, not as '{checked.name}'; change the name"
        )
    if checked.suffix.lower() == ".csv" and patches is not None and meters is not None:
        rows = no_factors(patches)
        names = group_index(rows)[0] if groups else row_names(rows)
        if (size := _ZERO * len(meters) * len(names)) > _MOST_TEXT:
            raise RadiosityError(
                f"'{path}' would have {len(meters)} x {len(names)} numbers and {size / 1e9:.3g} GB, which is of no "
                "use: write .npz, or groups (--groups)"
            )
        heads = [*_places(meters)[0], *names.tolist(), *_ENDS]
        if twice := [name for name, count in Counter([*heads, *map(_error, heads)]).items() if count > 1]:
            raise RadiosityError(
                f"'{path}' would have two columns '{twice[0]}', as a surface has this name: rename it, or write .npz"
            )
    return checked


def save_point_factors(
    path: str | os.PathLike[str], found: PointFactors, *, metadata: Mapping[str, Any] | None = None
) -> None:
    """Write view factors of sensors.

    ``.csv``: a row for each sensor: ``name`` if it has one, ``x,y,z,nx,ny,nz`` (of spherical ones ``x,y,z``), the
        factors of patches or groups by their names, the shares of ``sky``, ``ground`` and ``backs`` (of faces, and of
        obstacles); ``NAME_error``, the standard error of each of them; if known ``irradiance`` (of spherical sensors
        ``spherical_irradiance``) and its error, with several channels numbered from 1.
    ``.npz``: the matrix, for :func:`scipy.sparse.load_npz`, with ``errors`` (of each of its ``data``); ``names`` of its
        columns; ``sky``, ``ground``, ``dark`` and their errors (``sky_error``); ``points``, ``directions``, ``sensors``
        (their names), ``quantity``, ``rays``; if known ``irradiance``, ``irradiance_error``; and ``metadata`` (JSON).

    Raises the errors of :func:`check_point_file`, :class:`etendue.core.OutputError` if the file cannot be written.
    """
    place = check_point_file(path)
    if place.suffix.lower() == ".csv":
        with replacing(place) as part, part.open("w", encoding="utf-8", newline="") as file:
            _write_table(csv.writer(file, lineterminator="\n"), found)
        return
    matrix, errors, meters = found.matrix, found.errors, found.meters
    light = {"irradiance": found.irradiance, "irradiance_error": found.irradiance_error}
    save_arrays(
        place,
        {
            # The names of the first six are those of SciPy.
            "format": np.array(b"csr"),
            "_is_array": np.array(True),
            "shape": np.array(matrix.shape),
            "data": matrix.data,
            "indices": matrix.indices,
            "indptr": matrix.indptr,
            "errors": errors.data,
            "names": found.names,
            **found.ends,
            "points": meters.points,
            "directions": meters.directions,
            "sensors": np.array(meters.names, dtype=str),
            "quantity": np.array(meters.quantity),
            "rays": np.array(found.rays),
            **{name: values for name, values in light.items() if values is not None},
        },
        metadata,
    )


def _write_table(writer: Any, found: PointFactors) -> None:
    heads, places = _places(found.meters)
    names = [*found.names.tolist(), *_ENDS]
    light, of_light = [], np.zeros((len(found), 0))
    if found.irradiance is not None and found.irradiance_error is not None:
        what = "irradiance" if found.meters.quantity == "irradiance" else "spherical_irradiance"
        channels = found.irradiance.shape[1]
        light = [what] if channels == 1 else [f"{what}_{c}" for c in range(1, channels + 1)]
        of_light = np.concatenate([found.irradiance, found.irradiance_error], axis=1)
    writer.writerow([*heads, *names, *map(_error, names), *light, *map(_error, light)])
    parts = [
        (matrix, [found.ends[name + suffix] for name in _ENDS.values()])
        for matrix, suffix in ((found.matrix, ""), (found.errors, "_error"))
    ]
    for k, row in enumerate(places):
        for matrix, ends in parts:
            cells = ["0"] * len(found.names)
            for j in range(matrix.indptr[k], matrix.indptr[k + 1]):
                cells[matrix.indices[j]] = f"{matrix.data[j]:.9g}"
            row = [*row, *cells, *(f"{values[k]:.9g}" for values in ends)]
        writer.writerow([*row, *(f"{value:.9g}" for value in of_light[k])])


def _places(meters: Meters) -> tuple[list[str], list[list[str]]]:
    """Names of the columns that tell what the sensors are, and rows of them."""
    is_plane = meters.quantity == "irradiance"
    numbers = np.concatenate([meters.points, meters.directions], axis=1) if is_plane else meters.points
    heads = [*(["name"] if meters.names else []), *("x", "y", "z", "nx", "ny", "nz")[: numbers.shape[1]]]
    rows = ([*meters.names[k : k + 1], *(f"{value:.9g}" for value in row)] for k, row in enumerate(numbers))
    return heads, list(rows)


def _error(name: str) -> str:
    return f"{name}_error"


def read_light(path: str | os.PathLike[str], patches: Patches) -> tuple[Array, Array]:
    """Radiosities (n, c) of the patches and of the sky (c,), from ``.npz`` of a solution (:func:`save_solution`), or of
    temperatures and heat.

    Raises :class:`RadiosityError` for another file, and for a solution of other patches.
    """
    try:
        with np.load(path, allow_pickle=False) as saved:
            radiosity, sky, areas, centres = (saved[name] for name in ("radiosity", "sky", "areas", "centres"))
    except FileNotFoundError:
        raise RadiosityError(f"there is no file of a solution '{path}'") from None
    except (OSError, KeyError, ValueError, EOFError, AttributeError, TypeError, BadZipFile) as error:
        raise RadiosityError(
            f"'{path}' has no radiosities of patches: take .npz of etendue radiosity, or of etendue heat"
        ) from error
    if len(areas) != len(patches):
        raise RadiosityError(
            f"'{path}' is the solution of {len(areas)} patches, and there are {len(patches)}: read the mesh as for the "
            "solution (--max-area, --ids, --two-sided)"
        )
    moved = np.linalg.norm(centres - patches.centres, axis=1) > _SAME * patches.sphere[1]
    if (other := np.flatnonzero(moved | (np.abs(areas - patches.areas) > _SAME * patches.areas))).size:
        raise RadiosityError(f"'{path}' is the solution of other patches: patch {other[0]} is elsewhere, or larger")
    return radiosity, sky
