"""Reading of saved solutions, to render or convert them without solving again."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.formats import netcdf_metadata
from etendue.surfaces import saved_patches

from ..errors import RadiosityError
from ..solvers.system import Solution
from .netcdf import read_netcdf_solution

#: The arrays read from a file, and those that it may have.
_NEEDED = (
    *("vertices", "faces", "front", "back", "labels", "reflectance", "emission", "sky"),
    *("radiosity", "irradiance", "sky_share", "residuals"),
)
_OPTIONAL = ("irradiance_error", "shapes", "shape_names", "face", "other_side")


def read_solution(path: str | os.PathLike[str]) -> tuple[Solution, Array | None]:
    """Read a solution with its patches that :func:`save_solution` wrote as ``.npz`` or ``.nc``, and the standard error
    of the irradiance (``None`` if it was not saved). Raises :class:`RadiosityError` for another file,
    :class:`FormatError` for a damaged netCDF file."""
    try:
        saved = read_netcdf_solution(path) if Path(path).suffix.lower() == ".nc" else _read_arrays(path)
        patches = saved_patches(saved, **{name: saved[name] for name in ("reflectance", "emission", "sky")})
        patches.labels = saved["labels"].astype(np.int64)
        if "shapes" in saved:
            patches.shapes, patches.shape_names = saved["shapes"], tuple(map(str, saved["shape_names"]))
        numbers = (saved["radiosity"], saved["irradiance"], saved["sky_share"])
        if any(len(values) != len(patches) for values in numbers):
            raise RadiosityError(f"'{path}' is damaged: its arrays have different numbers of patches")
        solution = Solution(patches, *numbers, tuple(saved["residuals"].tolist()))
    except (KeyError, ValueError, IndexError) as error:
        raise _foreign(path) from error
    return solution, saved.get("irradiance_error")


def solution_metadata(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The ``metadata`` of a file of :func:`save_solution`, ``.npz`` or ``.nc``; empty if it has none. Raises the errors
    of :func:`read_solution`."""
    if Path(path).suffix.lower() == ".nc":
        return netcdf_metadata(path)
    try:
        with np.load(path, allow_pickle=False) as saved:
            return dict(json.loads(str(saved["metadata"]))) if "metadata" in saved else {}
    except (OSError, ValueError, EOFError, AttributeError, TypeError, BadZipFile) as error:
        raise _foreign(path) from error


def _read_arrays(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as saved:
            return {name: saved[name] for name in (*_NEEDED, *_OPTIONAL) if name in saved}
    except FileNotFoundError:
        raise RadiosityError(f"there is no file of a solution '{path}'") from None
    except (OSError, ValueError, EOFError, AttributeError, TypeError, BadZipFile) as error:
        raise _foreign(path) from error


def _foreign(path: str | os.PathLike[str]) -> RadiosityError:
    return RadiosityError(f"'{path}' is no file of a solution that save_solution wrote as .npz or .nc")
