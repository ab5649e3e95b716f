"""Solutions in files for NumPy, ParaView and renderers. Files are written atomically."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.formats import far_centre, netcdf_library, save_arrays, write_gltf, write_mesh
from etendue.lighting import photometric as luminous
from etendue.surfaces import face_sides, vertex_radiosity

from ..errors import RadiosityError
from ..factors.formfactors import numbers_of
from ..solvers.system import Solution
from .colours import coloured_mesh
from .netcdf import write_solution

#: Suffixes of files of solutions, and their meaning.
SOLUTION_FILES = {
    ".npz": "arrays of NumPy",
    ".vtu": "ParaView",
    ".ply": "vertex colours",
    ".nc": "netCDF",
    ".glb": "vertex colours in one file",
    ".gltf": "the same, as text",
}


def check_file(path: str | os.PathLike[str], known: Collection[str]) -> str:
    """The suffix of ``path`` in lower case; raises :class:`RadiosityError` if it is not among ``known``,
    :class:`etendue.core.BackendError` for netCDF without its library."""
    suffix = Path(path).suffix.lower()
    if suffix not in known:
        what = f"'{suffix}' is not known" if suffix else "it has no suffix"
        raise RadiosityError(f"the suffix of '{path}' decides its format: {what}; take {', '.join(known)}")
    if suffix == ".nc":
        netcdf_library(path)
    return suffix


def save_solution(
    path: str | os.PathLike[str],
    solution: Solution,
    *,
    irradiance_error: ArrayLike | None = None,
    angle: float = 30.0,
    photometric: bool = False,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write a solution by the suffix of ``path``.

    ``.npz``: arrays by patch, named like those of :class:`Solution` and :class:`Patches`, with ``face``, ``label`` and
        ``name``, the mesh, names of shapes, and ``metadata``.
    ``.vtu``: for ParaView: every face with ``radiosity``, ``irradiance``, ``net_flux`` (radiosity minus irradiance),
        ``emission``, ``reflectance``, ``sky_share``, ``patch``, ``face`` and ``label``. A back that belongs to a patch
        is a face of its own.
    ``.ply``: vertices with ``red``, ``green``, ``blue``: radiosity, linear floats, smoothed over edges of at most
        ``angle`` degrees (:func:`vertex_radiosity`); for one or three channels.
    ``.nc``: netCDF with arrays by patch as in ``.npz``, and the mesh, with units.
    ``.glb``, ``.gltf``: the smooth radiosities of ``.ply`` as vertex colours of glTF (:func:`write_gltf`).

    irradiance_error: (n, c) standard error of the irradiance, such as ``solution.irradiance_error(segments)``; it is
    written to ``.npz``, ``.nc`` and ``.vtu``, and, times the reflectance, as ``radiosity_error``: the error of the last
    bounce, which is nearly all of the error. photometric: ``.npz``, ``.nc`` and ``.vtu`` also have ``illuminance`` in
    lx, ``luminous_exitance`` in lm/m^2, and with an error ``illuminance_error``. metadata: values for JSON, for
    ``.npz``, ``.nc`` and glTF.

    Raises :class:`RadiosityError` for another suffix, errors of another shape, and channels that ``.ply`` cannot show,
    :class:`etendue.lighting.LightingError` for channels without luminance,
    :class:`etendue.core.BackendError` without meshio, :class:`etendue.core.OutputError` if the file cannot be written.
    """
    suffix = check_file(path, SOLUTION_FILES)
    patches = solution.patches
    if suffix in (".ply", ".glb", ".gltf"):
        if patches.channels not in (1, 3):
            raise RadiosityError(f"{suffix} shows one channel or three, not {patches.channels}; write .vtu or .npz")
        smooth = vertex_radiosity(patches, solution.radiosity, angle)
        if suffix != ".ply":
            write_gltf(path, coloured_mesh(solution, smooth), metadata)
            return
        colours = np.broadcast_to(smooth.values, (len(smooth.values), 3)).astype(np.float32)
        data = {name: np.ascontiguousarray(c) for name, c in zip(("red", "green", "blue"), colours.T, strict=True)}
        # Far from the origin in double precision.
        vertices = smooth.vertices.astype(np.float32 if far_centre(smooth.vertices) is None else np.float64)
        write_mesh(path, "ply", vertices, smooth.faces, data, {})
        return
    by_patch: dict[str, NDArray[Any]] = {
        "radiosity": solution.radiosity,
        "irradiance": solution.irradiance,
        "net_flux": solution.radiosity - solution.irradiance,
        "emission": patches.emission,
        "reflectance": patches.reflectance,
        "sky_share": solution.sky_share,
    }
    if irradiance_error is not None:
        error = np.asarray(irradiance_error, dtype=np.float64)
        if error.shape != solution.irradiance.shape:
            raise RadiosityError(f"errors of the irradiance have its shape, {solution.irradiance.shape}: {error.shape}")
        by_patch |= {"irradiance_error": error, "radiosity_error": patches.reflectance * error}
    if photometric:
        by_patch |= {"illuminance": solution.illuminance, "luminous_exitance": solution.luminous_exitance}
        if irradiance_error is not None:
            by_patch["illuminance_error"] = luminous(irradiance_error)
        units = {"illuminance": "lx", "luminous_exitance": "lm/m^2", "illuminance_error": "lx"}
        metadata = {**(metadata or {}), "units": {name: units[name] for name in units if name in by_patch}}
    if suffix == ".nc":
        write_solution(path, solution, by_patch, metadata)
        return
    if suffix == ".vtu":
        corners, patch = face_sides(patches)
        numbers = {"patch": np.arange(len(patches)), "face": patches.face, "label": patches.labels}
        cells = {name: values[patch] for name, values in (by_patch | numbers).items()}
        write_mesh(path, "vtu", patches.vertices, corners, {}, cells)
        return
    geometry = ("areas", "normals", "centres", "labels", "vertices", "faces", "front", "back", "other_side", "sky")
    rest = {name: getattr(patches, name) for name in geometry}
    if patches.shapes is not None:
        rest |= {"shapes": patches.shapes, "shape_names": np.array(patches.shape_names, dtype=str)}
    rest |= numbers_of(patches)
    save_arrays(path, by_patch | rest | {"residuals": np.array(solution.residuals)}, metadata)
