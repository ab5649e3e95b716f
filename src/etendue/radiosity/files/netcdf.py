"""Form factors, segments and solutions as netCDF, the format of climate models, MATLAB, R and xarray."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import sparse
from etendue.formats import NetcdfFile, read_netcdf
from etendue.surfaces import Patches

from ..errors import RadiosityError
from ..factors.formfactors import NUMBERS, FormFactors, numbers_of
from ..lines.segments import Segments
from ..solvers.system import Solution

if TYPE_CHECKING:
    import scipy.sparse

_PER_AREA, _SHARE, _METRES, _AREA = "W m-2", "1", "m", "m2"


def write_form_factors(
    path: str | os.PathLike[str], factors: FormFactors, emissivity: NDArray[Any], metadata: Mapping[str, Any] | None
) -> None:
    """Write the matrix by rows: row ``i`` has the entries from ``row_start[i]`` to ``row_start[i + 1] - 1``, in columns
    ``column``."""
    matrix, errors = same_structure(factors)
    file = NetcdfFile("Form factors (view factors) between patches of surfaces", metadata)
    file.add("row_start", "row_boundary", matrix.indptr, "first entry of each row of the matrix, and their number")
    file.add("column", "entry", matrix.indices, "patch that is seen, counted from 0")
    file.add("form_factor", "entry", matrix.data, "share of the light of a patch that reaches another one", _SHARE)
    file.add("form_factor_error", "entry", errors.data, "standard error of the form factor", _SHARE)
    file.add("area", "patch", factors.areas, "area of the patch", _AREA)
    leaves = "share of the light of a patch that leaves the scene"
    if factors.ground is None:
        file.add("sky_share", "patch", factors.sky, leaves, _SHARE)
    else:
        file.add("sky_share", "patch", factors.sky, f"{leaves} upward", _SHARE)
        file.add("ground_share", "patch", factors.ground, f"{leaves} downward", _SHARE)
    if factors.sky_patches is not None:
        about = f"{leaves} to each patch of the sky, from the horizon up (Tregenza, Reinhart)"
        file.add("sky_patch_share", "patch sky_patch", factors.sky_patches, about, _SHARE)
    file.add("dark_share", "patch", factors.dark, "share of the light of a patch that ends on backs of faces", _SHARE)
    file.add("lines", "patch", factors.lines, "lines that met the patch", _SHARE)
    file.add("emissivity", "patch", emissivity, "emissivity of the patch", _SHARE)
    _add_numbers(file, factors.numbers)
    if factors.name is not None and factors.name.any():
        file.add_texts("name", "patch name_letter", factors.name, "name of the shape that the patch is of")
    if factors.zone is not None:
        file.add_texts("zone", "patch zone_letter", factors.zone, "zone that the patch faces")
    file.write(path)


def read_netcdf_form_factors(path: str | os.PathLike[str]) -> FormFactors:
    """Inverse of :func:`write_form_factors`."""
    needed = ("row_start", "column", "form_factor", "form_factor_error", "area", "sky_share", "lines")
    saved = read_netcdf(path, "form factors", needed)
    n, structure = len(saved["area"]), (saved["column"], saved["row_start"])
    matrix, errors = (
        sparse().csr_array((saved[name], *structure), shape=(n, n)) for name in ("form_factor", "form_factor_error")
    )
    numbers = {name: saved[name] for name in NUMBERS if name in saved}
    if numbers:
        numbers["name"] = _texts(saved["name"]) if "name" in saved else np.full(n, "")
    if "zone" in saved:
        numbers["zone"] = _texts(saved["zone"])
    dark, lines = saved.get("dark_share", np.zeros(n)), saved["lines"].astype(np.int64)
    parts = {name: saved.get(known) for name, known in (("ground", "ground_share"), ("sky_patches", "sky_patch_share"))}
    return FormFactors(matrix, errors, saved["sky_share"], saved["area"], lines, dark, **numbers, **parts)


def save_segments(
    path: str | os.PathLike[str], segments: Segments, *, metadata: Mapping[str, Any] | None = None
) -> None:
    """Write segments as netCDF (``.nc``), 8 bytes each before compression: for scenes with about as many form factors
    as segments.

    ``pairs_0``, ``pairs_1`` and so on, (segments, 2), are the batches of lines, in their order. A pair has the indices
    of two patches that see each other, counted from 0, or of sky or dark, which are attributes. ``area`` and
    ``expected`` have a value per patch. Raises :class:`RadiosityError` for another suffix, and for segments with local
    rays, which can be added after reading.
    """
    if segments.correction is not None:
        raise RadiosityError(
            "segments with local rays cannot be saved: save those of lines, and call with_local_rays() after reading"
        )
    if Path(path).suffix.lower() != ".nc":
        raise RadiosityError(f"segments are written as .nc, not as '{path}'; change the name")
    n = len(segments.patches)
    file = NetcdfFile("Segments of lines between patches of surfaces that see each other", metadata)
    file.add("area", "patch", segments.patches.areas, "area of the patch", _AREA)
    file.add("expected", "patch", segments.expected, "lines that should meet the patch", _SHARE)
    for batch in range(segments.batch_count):
        chunks = [chunk for chunk, of in zip(segments.chunks, segments.batches, strict=True) if of == batch]
        pairs = np.concatenate(chunks) if chunks else np.empty((0, 2), np.uint32)
        dimensions, about = f"segment_{batch} end", "patches that see each other"
        file.add(f"pairs_{batch}", dimensions, pairs, about, sky=n, dark=n + 1)
    file.write(path)


def read_segments(path: str | os.PathLike[str], patches: Patches) -> Segments:
    """Inverse of :func:`save_segments`; ``patches`` are those that the lines were cast through.

    Raises :class:`FormatError` for another file, :class:`RadiosityError` for patches of other areas.
    """
    saved = read_netcdf(path, "segments", ("area", "expected", "pairs_0"))
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
    """Write the arrays of :func:`save_solution`, and the mesh."""
    patches = solution.patches
    file = NetcdfFile("Radiosities of patches of surfaces", metadata)
    for name, values in by_patch.items():
        long_name, units = _MEANINGS[name]
        dimensions = "patch" if values.ndim == 1 else "patch channel"
        file.add(name, dimensions, values, long_name, units, coordinates="centre_x centre_y centre_z")
    file.add("area", "patch", patches.areas, "area of the patch", _AREA)
    _add_numbers(file, numbers_of(patches))
    file.add("other_side", "patch", patches.other_side, "patch on the other side of a sheet; -1 for none")
    for axis, letter in enumerate("xyz"):
        file.add(f"centre_{letter}", "patch", patches.centres[:, axis], f"{letter} of the centre of the patch", _METRES)
        file.add(f"normal_{letter}", "patch", patches.normals[:, axis], f"{letter} of the normal of the patch", _SHARE)
        file.add(f"vertex_{letter}", "vertex", patches.vertices[:, axis], f"{letter} of the vertex", _METRES)
    about = "vertices of the face, counterclockwise seen from its front; a triangle repeats its last"
    file.add("face_vertices", "face corner", patches.faces, about)
    file.add("front_patch", "face", patches.front, "patch that the front of the face belongs to")
    file.add("back_patch", "face", patches.back, "patch that the back of the face belongs to; -1 for none")
    if patches.shapes is not None:
        file.add("shape", "patch", patches.shapes, "shape of the scene that the patch is of; -1 for none")
    if patches.shape_names:
        file.add_texts("shape_name", "shapes letter", patches.shape_names, "name of the shape")
    file.add("sky", "channel", patches.sky, "light that comes from where no face is", _PER_AREA)
    file.add("residual", "iteration", np.array(solution.residuals), "residual of the solution", _SHARE)
    file.write(path)


def read_netcdf_solution(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Inverse of :func:`write_solution`, by the names of :class:`Patches` and :class:`Solution`."""
    saved = read_netcdf(path, "a solution", ("radiosity", "irradiance", "face_vertices", "front_patch", "back_patch"))
    names = {
        "face_vertices": "faces",
        "front_patch": "front",
        "back_patch": "back",
        "label": "labels",
        "shape": "shapes",
    }
    found = {names.get(name, name): values for name, values in saved.items()}
    if "shapes" in found:
        found["shape_names"] = _texts(found.get("shape_name", np.zeros((0, 1), "S1")))
    found["residuals"] = found["residual"]
    found["vertices"] = np.stack([found[f"vertex_{letter}"] for letter in "xyz"], axis=1)
    return found


def _add_numbers(file: NetcdfFile, numbers: Mapping[str, Any]) -> None:
    """Add ``face`` and ``label``, if they are known."""
    if (face := numbers["face"]) is not None:
        file.add("face", "patch", face, "number of the first face of the patch in its mesh, counted from 0")
    if (label := numbers["label"]) is not None:
        file.add("label", "patch", label, "number of the patch, or of its face, where it was made")


def _texts(letters: NDArray[Any]) -> NDArray[np.str_]:
    return np.array([b"".join(row).decode() for row in letters], dtype=str)


_MEANINGS = {
    "radiosity": ("light that leaves the patch", _PER_AREA),
    "irradiance": ("light that arrives at the patch", _PER_AREA),
    "net_flux": ("light that leaves less what arrives", _PER_AREA),
    "emission": ("light that the patch emits", _PER_AREA),
    "reflectance": ("share of the light that the patch reflects", _SHARE),
    "sky_share": ("share of the light of a patch that leaves the scene", _SHARE),
    "illuminance": ("illuminance, 683 lm/W", "lx"),
    "luminous_exitance": ("luminous exitance, 683 lm/W", "lm m-2"),
    "illuminance_error": ("standard error of the illuminance, an upper estimate", "lx"),
    "irradiance_error": ("standard error of the irradiance", _PER_AREA),
    "radiosity_error": ("standard error of the radiosity", _PER_AREA),
}


def same_structure(factors: FormFactors) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Matrix and errors with sorted columns; raises :class:`RadiosityError` if entries and errors do not match."""
    matrix, errors = factors.matrix.tocsr(copy=True), factors.errors.tocsr(copy=True)
    matrix.sort_indices()
    errors.sort_indices()
    if not np.array_equal(matrix.indices, errors.indices) or not np.array_equal(matrix.indptr, errors.indptr):
        raise RadiosityError("form factors and their errors have different structures; give every entry an error")
    return matrix, errors
