"""Reading of saved solutions, to render or convert them without solving again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.surfaces import Patches

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
        patches = _patches(saved)
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


def _patches(saved: Mapping[str, NDArray[Any]]) -> Patches:
    """The patches, without their labels and shapes."""
    front, faces = saved["front"].astype(np.int64), saved["faces"].astype(np.int64)
    if "other_side" in saved:
        other = saved["other_side"]
        two_sided = other[(other < 0) | (other > np.arange(len(other)))] >= 0
    else:  # a file of an earlier version, without empty patches
        two_sided = np.zeros(int(front.max()) + 1, dtype=bool)
        two_sided[front[saved["back"] >= 0]] = True
    # Empty patches have a face that is left out.
    patch = np.concatenate([front, np.setdiff1d(np.arange(len(two_sided)), front)])
    return Patches(
        saved["vertices"],
        np.concatenate([faces, np.zeros((len(patch) - len(front), 4), np.int64)]),
        reflectance=saved["reflectance"],
        emission=saved["emission"],
        ids=patch,
        two_sided=two_sided,
        sky=saved["sky"],
        left_out=np.arange(len(front), len(patch)),
        numbers=saved["face"].astype(np.int64)[patch] if "face" in saved else None,
    )


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
