"""Arrays with names and units as netCDF, which climate models, MATLAB, R and xarray read.

Files are of the classic format with 64-bit offsets: every netCDF library reads it, and SciPy writes it. A variable
holds 2 GB; names, units and long names follow the CF conventions.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import library
from etendue.film import replacing

from .errors import FormatError

#: Largest variable: its size is a number of 31 bits.
_LARGEST = (1 << 31) - 4


@dataclass
class NetcdfFile:
    """A file before it is written: lengths of dimensions, variables, and attributes of the whole."""

    title: str
    metadata: Mapping[str, Any] | None
    lengths: dict[str, int] = field(default_factory=dict)
    variables: dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, Any]]] = field(default_factory=dict)

    def add(self, name: str, dimensions: str, values: Any, long_name: str, units: str = "", **more: Any) -> None:
        """A variable. Dimensions are names with a blank between; their lengths are those of ``values``."""
        names = tuple(dimensions.split())
        array = _storable(name, np.asarray(values))
        self.lengths |= dict(zip(names, array.shape, strict=True))
        attributes = {"long_name": long_name} | ({"units": units} if units else {}) | more
        self.variables[name] = (names, array, attributes)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write it, whole or not at all."""
        for name, (_, values, _) in self.variables.items():
            if values.nbytes > _LARGEST:
                raise FormatError(
                    f"'{name}' has {values.nbytes / 1e9:.1f} GB, and a variable of '{path}' holds 2: write .npz, or "
                    "segments in place of form factors"
                )
        netcdf = library("scipy.io", f"the netCDF file {path}")
        with replacing(path) as part, netcdf.netcdf_file(str(part), "w", version=2) as file:
            file.Conventions = "CF-1.11"
            file.title = self.title
            known = dict(self.metadata or {})
            file.source = str(known.get("software", "etendue")).encode()
            file.metadata = json.dumps(known).encode()
            for name, length in self.lengths.items():
                file.createDimension(name, length)
            for name, (dimensions, values, attributes) in self.variables.items():
                variable = file.createVariable(name, values.dtype, dimensions)
                variable[:] = values
                for key, value in attributes.items():
                    setattr(variable, key, value)


def _storable(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Whole numbers as 32 bits: the format has no longer ones."""
    if values.dtype.kind in "iub":
        if values.size and max(-int(values.min()), int(values.max())) >= 1 << 31:
            raise FormatError(f"'{name}' has numbers beyond 2^31, which netCDF's classic format cannot hold")
        return values.astype(np.int32)
    return values.astype(np.float64)


def read_netcdf(path: str | os.PathLike[str], what: str, needed: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """All variables of a file; raises :class:`FormatError` if that is not one of ``what``."""
    if not Path(path).is_file():
        raise FormatError(f"there is no file of {what} '{path}'")
    netcdf = library("scipy.io", f"the netCDF file {path}")
    try:
        with netcdf.netcdf_file(str(path), "r", mmap=False) as file:
            saved = {name: _native(variable.data) for name, variable in file.variables.items()}
    except Exception as error:  # SciPy's reader fails on foreign bytes in many ways
        raise FormatError(f"'{path}' is no netCDF file of the classic format, with {what}") from error
    missing = [name for name in needed if name not in saved]
    if missing:
        raise FormatError(f"'{path}' is no file of {what}: it has no variable '{missing[0]}'")
    return saved


def _native(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(values.dtype.newbyteorder("="))
