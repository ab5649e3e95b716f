"""Maps as files for ParaView, renderers and viewers."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, OptionError
from etendue.display import auto_exposure, tonemap, write_png
from etendue.formats import write_gltf, write_mesh
from etendue.surfaces import (
    Lightmap,
    MapSurfaces,
    NearestMap,
    PatchMap,
    SurfaceMap,
    atlas,
    face_sides,
    irradiance_at,
    lightmap_from,
    save_lightmap,
    save_map,
    save_textured_mesh,
    shown_exposure,
    vertex_colours,
    vertex_radiosity,
)

#: Suffixes of files of a map and their meaning.
MAP_FILES = {
    ".npz": "arrays of NumPy, in which paths can end",
    ".vtu": "ParaView",
    ".glb": "vertex colours in one file",
    ".gltf": "the same, as text",
    ".exr": "lightmap, with its mesh in .glb beside it",
    ".png": "lightmap, tone-mapped",
}


def check_map_file(path: str | os.PathLike[str]) -> str:
    """The suffix of a file of a map; raises :class:`OptionError` for an unknown one."""
    suffix = Path(path).suffix.lower()
    if suffix not in MAP_FILES:
        raise OptionError(f"a map is written as {', '.join(MAP_FILES)}, not as '{path}'; change the name")
    return suffix


def write_map(
    path: str | os.PathLike[str],
    made: SurfaceMap,
    surfaces: MapSurfaces,
    *,
    size: int = 1024,
    metadata: Mapping[str, Any] | None = None,
) -> tuple[Path, ...]:
    """Write any map on ``surfaces`` by the suffix of ``path`` (:data:`MAP_FILES`); returns the files.

    ``.vtu`` has ``irradiance``, ``irradiance_error`` (NaN where it is not known) and ``shape`` of each cell; glTF the
    irradiance interpolated between cells, as colours and as ``_IRRADIANCE``. ``.exr`` and ``.png`` are a texture of at
    most ``size`` texels a side for the mesh that is written beside it. metadata: values for JSON.

    Raises :class:`OptionError` for another suffix, and for ``.npz`` of a map that is neither of patches nor of
    neighbours; :class:`SurfaceError` if the texture is too small for the mesh; errors of the libraries and of writing.
    """
    target, suffix, about = Path(path), check_map_file(path), dict(metadata or {}) | {"map": made.kind}
    if suffix == ".npz":
        if not isinstance(made, PatchMap | NearestMap):
            raise OptionError(f"a map of kind '{made.kind}' has no file; write .vtu, or make cells of it")
        save_map(path, made, about)
        return (target,)
    if suffix in (".exr", ".png"):
        mesh, shape = atlas(surfaces.whole, size)
        texture = map_lightmap(made, mesh, shape)
        beside = target.with_suffix(".glb")
        save_textured_mesh(beside, mesh, target.name)
        if suffix == ".png":
            covered = texture.values[texture.covered][None]
            write_png(path, tonemap(texture.values, auto_exposure(covered)))
        else:
            save_lightmap(path, texture, about)
        return target, beside
    values, errors = on_cells(made, surfaces)
    patches = surfaces.patches
    if suffix == ".vtu":
        corners, patch = face_sides(patches)
        cells = {"irradiance": values, "irradiance_error": errors, "shape": surfaces.shapes}
        write_mesh(path, "vtu", patches.vertices, corners, {}, {name: x[patch] for name, x in cells.items()})
    else:
        smooth = vertex_radiosity(patches, values)
        write_gltf(path, vertex_colours(smooth, shown_exposure(values, patches.areas), "_IRRADIANCE"), about)
    return (target,)


def on_cells(made: SurfaceMap, surfaces: MapSurfaces) -> tuple[Array, Array]:
    """(irradiance (n, 3), its standard error) of cells: their own, or that at their centres."""
    if isinstance(made, PatchMap) and made.surfaces.patches is surfaces.patches:
        return made.values, np.full_like(made.values, np.nan) if made.errors is None else made.errors
    values, errors = irradiance_at(made, surfaces.patches.centres, surfaces.patches.normals)
    return np.nan_to_num(values), errors


def map_lightmap(made: SurfaceMap, mesh: Any, size: tuple[int, int]) -> Lightmap:
    """A texture of (width, height) ``size`` with the irradiance on a mesh with texture coordinates."""

    def evaluate(points: Array, normals: Array) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        values, _ = irradiance_at(made, points, normals)
        found = np.asarray(~np.isnan(values).any(axis=1))
        return np.where(found[:, None], values, 0.0).astype(np.float32), found

    return lightmap_from(evaluate, mesh, size)
