"""Arrays with names and units as netCDF, the format of climate models, MATLAB, R and xarray.

Files are of netCDF 4, which is HDF5: variables keep their types and may have any length; long ones are compressed.
Names, units and long names follow the CF conventions. Files of the classic format are read, too.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import BackendError, library
from etendue.film import replacing

from .errors import FormatError

#: Bytes of a chunk. Variables of several chunks are compressed, each by itself.
_CHUNK = 1 << 20


@dataclass
class NetcdfFile:
    """The content of a file: lengths of dimensions, variables, and attributes of the file."""

    title: str
    metadata: Mapping[str, Any] | None
    lengths: dict[str, int] = field(default_factory=dict)
    variables: dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, Any]]] = field(default_factory=dict)

    def add(self, name: str, dimensions: str, values: ArrayLike, long_name: str, units: str = "", **more: Any) -> None:
        """Add a variable. ``dimensions`` are names separated by spaces; their lengths are those of ``values``."""
        names = tuple(dimensions.split())
        array = np.asarray(values)
        if array.dtype == bool:  # netCDF has no booleans
            array = array.astype(np.int8)
        self.lengths |= dict(zip(names, array.shape, strict=True))
        attributes = {"long_name": long_name} | ({"units": units} if units else {}) | more
        self.variables[name] = (names, array, attributes)

    def add_texts(self, name: str, dimensions: str, texts: Iterable[str], long_name: str) -> None:
        """Add a variable of texts, as letters; the second of the ``dimensions`` is that of letters."""
        encoded = np.array([text.encode() for text in texts])
        self.add(name, dimensions, encoded.view("S1").reshape(len(encoded), -1), long_name, _Encoding="utf-8")

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file atomically.

        Raises :class:`etendue.core.BackendError` without h5netcdf, :class:`etendue.core.OutputError` if the file cannot
        be written.
        """
        h5netcdf = netcdf_library(path)
        known = dict(self.metadata or {})
        with replacing(path) as part, _Target(part, "r+") as target:
            try:
                with h5netcdf.File(target, "w") as file:
                    file.attrs["Conventions"] = "CF-1.11"
                    file.attrs["title"] = self.title
                    file.attrs["source"] = str(known.get("software", "etendue"))
                    file.attrs["metadata"] = json.dumps(known)
                    file.dimensions = self.lengths
                    for name, (dimensions, values, attributes) in self.variables.items():
                        if target.failure is None:
                            variable = file.create_variable(name, dimensions, data=values, **_storage(values))
                            variable.attrs.update(attributes)
            finally:
                if target.failure is not None:
                    raise target.failure


class _Target(io.FileIO):
    """A file that keeps the first failure of writing and ignores later writes.

    HDF5 must be able to close a file: otherwise the process later ends with a segmentation fault.
    """

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of ``data``, or nothing after a failure."""
        rest = memoryview(data).cast("B")
        size = len(rest)
        try:
            while rest and self.failure is None:
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.failure = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Truncate the file, or do nothing after a failure."""
        return super().truncate(size) if self.failure is None else size or 0


def netcdf_library(path: str | os.PathLike[str]) -> Any:
    """h5netcdf, with which the netCDF file ``path`` is written or read; raises :class:`etendue.core.BackendError`
    without it."""
    library("h5py", f"the netCDF file {path}", "netcdf")
    return library("h5netcdf", f"the netCDF file {path}", "netcdf")


def read_netcdf(path: str | os.PathLike[str], what: str, needed: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """All variables of a file; raises :class:`FormatError` for a file that does not contain ``what``."""
    if not Path(path).is_file():
        raise FormatError(f"there is no file of {what} '{path}'")
    try:
        with open(path, "rb") as file:
            classic = file.read(3) == b"CDF"
        saved = _read_classic(path) if classic else _read(path)
    except BackendError:
        raise
    except Exception as error:  # the libraries raise many types of errors for other files
        raise FormatError(f"'{path}' is no netCDF file of {what}") from error
    missing = [name for name in needed if name not in saved]
    if missing:
        raise FormatError(f"'{path}' is no file of {what}: it has no variable '{missing[0]}'")
    return {name: values.astype(values.dtype.newbyteorder("="), copy=False) for name, values in saved.items()}


def netcdf_metadata(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The metadata of a file that :class:`NetcdfFile` wrote; empty if it has none. Raises :class:`FormatError` for
    another file."""
    try:
        with netcdf_library(path).File(path, "r") as file:
            known = json.loads(file.attrs.get("metadata", "{}"))
    except BackendError:
        raise
    except Exception as error:  # the library raises many types of errors for other files
        raise FormatError(f"'{path}' is no netCDF file with metadata") from error
    return dict(known)


def _storage(values: NDArray[Any]) -> dict[str, Any]:
    """How an array is stored. At compression level 1, with shuffled bytes, form factors take a third of their size and
    segments a fifth; higher levels take several times as long and save little more."""
    if values.nbytes <= _CHUNK:
        return {}
    rows = max(1, _CHUNK * len(values) // values.nbytes)
    return {"chunks": (rows, *values.shape[1:]), "compression": "gzip", "compression_opts": 1, "shuffle": True}


def _read(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    with netcdf_library(path).File(path, "r") as file:
        return {name: variable[...] for name, variable in file.variables.items()}


def _read_classic(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """The classic format, of other programs and of early versions of étendue."""
    netcdf = library("scipy.io", f"the netCDF file {path}")
    with netcdf.netcdf_file(str(path), "r", mmap=False) as file:
        return {name: variable.data for name, variable in file.variables.items()}
