"""Form factors, segments and solutions as netCDF, which climate models, MATLAB, R and xarray read.

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

from etendue.core import BackendError
from etendue.film import replacing

from .errors import RadiosityError
from .formfactors import FormFactors, sparse
from .patches import Patches
from .segments import Segments
from .solvers import Solution

#: Largest variable: its size is a number of 31 bits.
_LARGEST = (1 << 31) - 4
_PER_AREA, _SHARE, _METRES, _AREA = "W m-2", "1", "m", "m2"


@dataclass
class _File:
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
                raise RadiosityError(
                    f"'{name}' has {values.nbytes / 1e9:.1f} GB, and a variable of '{path}' holds 2: write .npz, or "
                    "segments in place of form factors"
                )
        with replacing(path) as part, _library().netcdf_file(str(part), "w", version=2) as file:
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


def write_form_factors(
    path: str | os.PathLike[str], factors: FormFactors, emissivity: NDArray[Any], metadata: Mapping[str, Any] | None
) -> None:
    """The matrix by rows: entries ``row_start[i]`` to ``row_start[i + 1]`` are row ``i``, in columns ``column``."""
    matrix, errors = same_structure(factors)
    file = _File("Form factors (view factors) between patches of surfaces", metadata)
    file.add("row_start", "row_boundary", matrix.indptr, "first entry of each row of the matrix, and their number")
    file.add("column", "entry", matrix.indices, "patch that is seen, counted from 0")
    file.add("form_factor", "entry", matrix.data, "share of the light of a patch that reaches another one", _SHARE)
    file.add("form_factor_error", "entry", errors.data, "standard error of the form factor", _SHARE)
    file.add("area", "patch", factors.areas, "area of the patch", _AREA)
    file.add("sky_share", "patch", factors.sky, "share of the light of a patch that leaves the scene", _SHARE)
    file.add("lines", "patch", factors.lines.astype(np.float64), "lines that met the patch", _SHARE)
    file.add("emissivity", "patch", emissivity, "emissivity of the patch", _SHARE)
    file.write(path)


def read_netcdf_form_factors(path: str | os.PathLike[str]) -> FormFactors:
    """What :func:`write_form_factors` wrote."""
    saved = _read(path, "form factors", ("row_start", "column", "form_factor", "form_factor_error", "area"))
    n, structure = len(saved["area"]), (saved["column"], saved["row_start"])
    matrix, errors = (
        sparse().csr_array((saved[name], *structure), shape=(n, n)) for name in ("form_factor", "form_factor_error")
    )
    return FormFactors(matrix, errors, saved["sky_share"], saved["area"], saved["lines"].astype(np.int64))


def save_segments(
    path: str | os.PathLike[str], segments: Segments, *, metadata: Mapping[str, Any] | None = None
) -> None:
    """Write segments as netCDF (``.nc``), 8 bytes each: for scenes whose form factors would be as many as they.

    ``pairs_0``, ``pairs_1`` and so on, (segments, 2), are the batches of lines, in their order; a pair are two patches
    that see each other, counted from 0, or ``sky`` or ``dark``, which its attributes say. ``area`` and ``expected``
    belong to patches. Raises :class:`RadiosityError` for another suffix, for batches of more than 2 GB, and for
    segments with local rays, which can be mixed in again.
    """
    if segments.correction is not None:
        raise RadiosityError("only segments of lines are written: save them, and mix local rays in when they are read")
    if Path(path).suffix.lower() != ".nc":
        raise RadiosityError(f"segments are written as .nc, not as '{path}'; change the name")
    n = len(segments.patches)
    file = _File("Segments of lines between patches of surfaces that see each other", metadata)
    file.add("area", "patch", segments.patches.areas, "area of the patch", _AREA)
    file.add("expected", "patch", segments.expected, "lines that should meet the patch", _SHARE)
    for batch in range(segments.batch_count):
        chunks = [chunk for chunk, of in zip(segments.chunks, segments.batches, strict=True) if of == batch]
        pairs = np.concatenate(chunks) if chunks else np.empty((0, 2), np.uint32)
        dimensions, about = f"segment_{batch} end", "patches that see each other"
        file.add(f"pairs_{batch}", dimensions, pairs, about, sky=n, dark=n + 1)
    file.write(path)


def read_segments(path: str | os.PathLike[str], patches: Patches) -> Segments:
    """What :func:`save_segments` wrote, of these patches: those that the lines were cast through.

    Raises :class:`RadiosityError` for another file, and for patches of other areas.
    """
    saved = _read(path, "segments", ("area", "expected", "pairs_0"))
    if len(patches) != len(saved["area"]) or not np.allclose(patches.areas, saved["area"], rtol=1e-6, atol=0):
        raise RadiosityError(
            f"the segments of '{path}' are of {len(saved['area'])} patches of other areas; give the patches that the "
            "lines were cast through"
        )
    count = sum(name.startswith("pairs_") for name in saved)
    chunks = [saved[f"pairs_{k}"].astype(np.uint32) for k in range(count)]
    return Segments(patches, chunks, np.arange(count), saved["expected"])


def write_solution(
    path: str | os.PathLike[str],
    solution: Solution,
    by_patch: Mapping[str, NDArray[Any]],
    metadata: Mapping[str, Any] | None,
) -> None:
    """The arrays of :func:`save_solution`, and the mesh."""
    patches = solution.patches
    file = _File("Radiosities of patches of surfaces", metadata)
    for name, values in by_patch.items():
        long_name, units = _MEANINGS[name]
        dimensions = "patch" if values.ndim == 1 else "patch channel"
        file.add(name, dimensions, values, long_name, units, coordinates="centre_x centre_y centre_z")
    file.add("area", "patch", patches.areas, "area of the patch", _AREA)
    file.add("label", "patch", patches.labels, "number of the patch, or of its face, where it was made")
    for axis, letter in enumerate("xyz"):
        file.add(f"centre_{letter}", "patch", patches.centres[:, axis], f"{letter} of the centre of the patch", _METRES)
        file.add(f"normal_{letter}", "patch", patches.normals[:, axis], f"{letter} of the normal of the patch", _SHARE)
        file.add(f"vertex_{letter}", "vertex", patches.vertices[:, axis], f"{letter} of the vertex", _METRES)
    about = "vertices of the face, counterclockwise seen from its front; a triangle repeats its last"
    file.add("face_vertices", "face corner", patches.faces, about)
    file.add("front_patch", "face", patches.front, "patch that the front of the face belongs to")
    file.add("back_patch", "face", patches.back, "patch that the back of the face belongs to; -1 for none")
    file.add("sky", "channel", patches.sky, "light that comes from where no face is", _PER_AREA)
    file.add("residual", "iteration", np.array(solution.residuals), "residual of the solution", _SHARE)
    file.write(path)


def read_netcdf_solution(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """What :func:`write_solution` wrote, by the names of :class:`Patches` and :class:`Solution`."""
    saved = _read(path, "a solution", ("radiosity", "irradiance", "face_vertices", "front_patch", "back_patch"))
    names = {"face_vertices": "faces", "front_patch": "front", "back_patch": "back", "label": "labels"}
    found = {names.get(name, name): values for name, values in saved.items()}
    found["residuals"] = found["residual"]
    found["vertices"] = np.stack([found[f"vertex_{letter}"] for letter in "xyz"], axis=1)
    return found


_MEANINGS = {
    "radiosity": ("light that leaves the patch", _PER_AREA),
    "irradiance": ("light that arrives at the patch", _PER_AREA),
    "net_flux": ("light that leaves less what arrives", _PER_AREA),
    "emission": ("light that the patch emits", _PER_AREA),
    "reflectance": ("share of the light that the patch reflects", _SHARE),
    "sky_share": ("share of the light of a patch that leaves the scene", _SHARE),
    "irradiance_error": ("standard error of the irradiance", _PER_AREA),
    "radiosity_error": ("standard error of the radiosity", _PER_AREA),
}


def same_structure(factors: FormFactors) -> tuple[Any, Any]:
    """Matrix and errors with sorted columns; raises :class:`RadiosityError` if entries and errors do not match."""
    matrix, errors = factors.matrix.tocsr(copy=True), factors.errors.tocsr(copy=True)
    matrix.sort_indices()
    errors.sort_indices()
    if not np.array_equal(matrix.indices, errors.indices) or not np.array_equal(matrix.indptr, errors.indptr):
        raise RadiosityError("form factors and their errors are not of equal structure; give every entry an error")
    return matrix, errors


def _storable(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Whole numbers as 32 bits: the format has no longer ones."""
    if values.dtype.kind in "iub":
        if values.size and max(-int(values.min()), int(values.max())) >= 1 << 31:
            raise RadiosityError(f"'{name}' has numbers beyond 2^31, which netCDF's classic format cannot hold")
        return values.astype(np.int32)
    return values.astype(np.float64)


def _read(path: str | os.PathLike[str], what: str, needed: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """All variables of a file; raises :class:`RadiosityError` if that is not one of ``what``."""
    if not Path(path).is_file():
        raise RadiosityError(f"there is no file of {what} '{path}'")
    try:
        with _library().netcdf_file(str(path), "r", mmap=False) as file:
            saved = {name: _native(variable.data) for name, variable in file.variables.items()}
    except Exception as error:  # SciPy's reader fails on foreign bytes in many ways
        raise RadiosityError(f"'{path}' is no netCDF file of the classic format, with {what}") from error
    missing = [name for name in needed if name not in saved]
    if missing:
        raise RadiosityError(f"'{path}' is no file of {what}: it has no variable '{missing[0]}'")
    return saved


def _native(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(values.dtype.newbyteorder("="))


def _library() -> Any:
    try:
        import scipy.io
    except ImportError as error:
        raise BackendError("netCDF files need SciPy: pip install 'etendue[radiosity]'") from error
    return scipy.io
