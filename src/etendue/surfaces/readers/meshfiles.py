"""Patches from mesh files, read by meshio (PLY, STL, VTK, VTU, VTP, Gmsh and more), trimesh (glTF and more), or here
(OBJ, OFF)."""

from __future__ import annotations

import contextlib
import io
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, library, logger, suggest

from ..errors import PatchError
from ..faces import face_vectors, flat_faces, repeated
from ..heat import thermal
from ..patches import Patches, warn_of_rounded
from .polygons import cut_polygons, grid_of_polydata, polygons_of, read_obj, read_off

Index = NDArray[np.int64]

#: Supported cell types.
_FACES = ("triangle", "quad")
#: Number of broken faces that a warning names.
_NAMED = 20
#: Suffixes that trimesh reads and meshio does not.
_TRIMESH = (".gltf", ".glb", ".3mf", ".dae")
#: Suffixes of text that is read here, and of files that may be VTK's PolyData.
_OWN, _VTK = (".off", ".obj"), (".vtk", ".vtp")
#: Vertices, faces (f, 4), the face of the file that each of them is or is a part of, and arrays by face of the file.
_Read = tuple[Array, Index, Index, dict[str, Array]]


def read_patches(
    path: str | Path,
    *,
    reflectance: ArrayLike | str = 0.0,
    emission: ArrayLike | str = 0.0,
    temperature: ArrayLike | str | None = None,
    ids: ArrayLike | str | None = None,
    two_sided: ArrayLike = False,
    sky: ArrayLike = 0.0,
    objects: str | None = None,
) -> Patches:
    """Patches of a mesh file, with the arguments of :class:`Patches`.

    reflectance, emission, ids: also the name of a cell-data array of the file, with a value for each face; a patch of
        several faces gets their area-weighted mean. For the array ``"emissivity"`` the reflectance is one minus its
        values.
    temperature: in kelvin, in the same forms: patches then emit as grey bodies whose emissivity is one minus the
        reflectance, in W/m^2 (:func:`thermal`).
    objects: an array of the file with the number of an object for each face, negative for walls; the objects become
        the ``shapes`` of the patches, for :func:`find_objects`.

    Reads polygons and ignores lines and solids; polygons of more than four corners become triangles of one patch. Faces
    without area and duplicates are left out with a warning; their patches keep their rows, see ``left_out`` of
    :class:`Patches`. Raises :class:`PatchError` for a file that cannot be read, without faces, with other types of
    faces, or without the named array, and :class:`etendue.core.BackendError` if the library that reads it is not
    installed.
    """
    path = Path(path)
    if not path.is_file():
        raise PatchError(f"there is no mesh file {path}")
    if path.stat().st_size == 0:
        raise PatchError(f"{path} is empty")
    if temperature is not None and (isinstance(emission, str) or np.any(emission)):
        raise PatchError("patches emit by their temperature or have an emission; give one of the two")
    suffix = path.suffix.lower()
    read = _by_trimesh if suffix in _TRIMESH else _by_own if suffix in _OWN else _by_meshio
    vertices, faces, rows, cells = read(path)
    if len(faces) == 0:
        raise PatchError(f"{path} has no triangles or quadrilaterals")
    left_out = broken_faces(vertices, faces, str(path), rows=rows)

    labels = _cell_array(path, cells, ids, whole=True)
    rho = (
        1 - _cell_array(path, cells, reflectance)
        if isinstance(reflectance, str) and reflectance == "emissivity"
        else _cell_array(path, cells, reflectance)
    )
    exitance, kelvin = _cell_array(path, cells, emission), _cell_array(path, cells, temperature)
    if labels is not None:
        groups, inverse = np.unique(labels, return_inverse=True)
        areas = np.linalg.norm(face_vectors(vertices, faces)[0], axis=1)
        areas[left_out] = 0.0
        areas = np.bincount(rows, areas).astype(np.float64)
        if isinstance(reflectance, str):
            rho = _means(rho, inverse, areas, len(groups))
        if isinstance(emission, str):
            exitance = _means(exitance, inverse, areas, len(groups))
        if isinstance(temperature, str):
            kelvin = _means(kelvin, inverse, areas, len(groups))
    ids_of_parts = rows if labels is None else labels[rows]
    rest: Any = {"ids": ids_of_parts, "numbers": rows, "two_sided": two_sided, "sky": sky, "left_out": left_out}
    patches = Patches(vertices, faces, reflectance=rho, emission=exitance, **rest)
    if objects is not None:
        numbers = _cell_array(path, cells, objects, whole=True)
        _set_shapes(
            patches, np.arange(rows[-1] + 1) if labels is None else labels, numbers, f"{path}, array '{objects}'"
        )
    return patches if temperature is None else _warm(patches, np.asarray(kelvin, dtype=np.float64).ravel(), sky)


def _set_shapes(patches: Patches, labels: Index, numbers: Index, array: str) -> None:
    """The object of each patch, from the numbers of the faces and the labels of their patches."""
    known, patch = np.unique(labels, return_inverse=True)
    low, high = np.full(len(known), numbers.max()), np.full(len(known), numbers.min())
    np.minimum.at(low, patch, numbers)
    np.maximum.at(high, patch, numbers)
    torn = np.flatnonzero(low != high)
    if len(torn):
        raise PatchError(
            f"{array}: patch {known[torn[0]]} has faces of the objects {low[torn[0]]} and {high[torn[0]]}; a patch "
            "belongs to one object"
        )
    number = low[np.searchsorted(known, patches.labels)]
    names = np.unique(number[number >= 0])
    patches.shapes = np.where(number < 0, -1, np.searchsorted(names, number))
    patches.shape_names = tuple(map(str, names))


def _warm(patches: Patches, kelvin: Array, sky: ArrayLike) -> Patches:
    """Patches with temperatures: one for all, for each front (a back has that of its front), or for each patch."""
    if patches.channels > 1:
        raise PatchError("grey bodies have one reflectance, not one for each channel: see thermal() for bands")
    back = patches.other_side[patches.other_side >= 0]
    fronts = len(patches) - len(back) // 2
    if len(kelvin) not in (1, fronts, len(patches)):
        raise PatchError(f"there are {len(kelvin)} temperatures for {fronts} patches")
    if len(kelvin) == fronts:
        kelvin = np.concatenate([kelvin, kelvin[back[back < fronts]]])
    return thermal(patches, kelvin, 1 - patches.reflectance).with_properties(sky=sky)


def broken_faces(
    vertices: Array, faces: Index, where: str, then: str = ", and their rows are zero", rows: Index | None = None
) -> Index:
    """Indices of degenerate faces (m, 4) and of duplicates, which are named in a warning with what happens ``then``.

    rows: the polygon that each face is a part of; a polygon is named if no part is left. Coincident faces of opposite
    orientation are no duplicates. Raises :class:`PatchError` if there are no other faces.
    """
    if not np.isfinite(vertices).all():
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        raise PatchError(
            f"{where}: {len(bad)} of {len(vertices)} vertices are not finite, the first is number {bad[0]}; repair "
            "the mesh"
        )
    try:
        quads, halves = flat_faces(vertices, faces)
    except PatchError as error:
        raise PatchError(f"{where}: {error}") from None
    _, flat = face_vectors(vertices, quads)
    empty = np.ones(len(faces), dtype=bool)
    np.logical_and.at(empty, halves, flat)
    kept = np.flatnonzero(~empty)
    twice = kept[repeated(vertices, faces[kept])]
    if len(twice) == len(kept):
        raise PatchError(f"{where}: none of {len(faces)} faces has an area")
    left_out = np.sort(np.concatenate([np.flatnonzero(empty), twice]))
    of = np.arange(len(faces)) if rows is None else rows
    gone = np.setdiff1d(of, np.delete(of, left_out))
    if len(gone):
        named = ", ".join(map(str, gone[:_NAMED])) + (", ..." if len(gone) > _NAMED else "")
        doubled = len(np.intersect1d(gone, of[twice]))
        logger.warning(
            "%s: of %d faces %d have no area and %d are duplicates; they are left out%s: face %s (counted from 0)",
            *(where, of[-1] + 1, len(gone) - doubled, doubled, then, named),
        )
    return left_out


def _cell_array(path: Path, cells: dict[str, Array], value: Any, whole: bool = False) -> Any:
    if not isinstance(value, str):
        return value
    if value not in cells:
        what = suggest(value, cells) if cells else "it has no arrays for its faces"
        raise PatchError(f"{path} has no array '{value}' for its faces; {what}")
    if not whole:
        return cells[value]
    labels = np.rint(cells[value]).ravel()
    if len(labels) != len(cells[value]) or not np.array_equal(labels, cells[value].ravel()):
        raise PatchError(f"{path}: the array '{value}' has no whole number for each face, and cannot number patches")
    return labels.astype(np.int64)


def _means(values: ArrayLike, group: Index, areas: Array, count: int) -> Array:
    columns = np.asarray(values, dtype=np.float64).reshape(len(group), -1).T
    weight = np.bincount(group, areas, count)
    inverse = np.divide(1.0, weight, out=np.zeros(count), where=weight > 0)
    kept = areas > 0  # faces that are left out may have any value
    sums = (np.bincount(group[kept], (column * areas)[kept], count) for column in columns)
    return np.stack([inverse * of_group for of_group in sums], axis=1)


def _by_meshio(path: Path) -> _Read:
    meshio = library("meshio", f"reading {path}")
    said = io.StringIO()
    try:
        data = path.read_bytes() if path.suffix.lower() in _VTK else b""
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):  # meshio prints to the terminal
            if (grid := grid_of_polydata(path, data)) is None:
                mesh = meshio.read(path)
            else:
                with tempfile.TemporaryDirectory() as folder:
                    copy = Path(folder, "mesh.vtk" if path.suffix.lower() == ".vtk" else "mesh.vtu")
                    copy.write_bytes(grid)
                    mesh = meshio.read(copy)
    except PatchError:
        raise
    except (Exception, SystemExit) as error:  # meshio exits the process for unknown formats
        reason = said.getvalue() if isinstance(error, SystemExit) else str(error)
        reason = " ".join(reason.split()).removeprefix("Error: ") or type(error).__name__
        reason = re.sub(r"\S+/mesh\.vt[ku]", str(path), reason)  # not the copy
        raise PatchError(f"{path} cannot be read as a mesh: {reason}") from error
    points = np.asarray(mesh.points)
    if points.ndim != 2:
        raise PatchError(f"{path} has no vertices")
    blocks = [(i, block) for i, block in enumerate(mesh.cells) if block.type in _FACES or "polygon" in block.type]
    others = [block for block in mesh.cells if block.type.startswith(_FACES) and block.type not in _FACES]
    if others:
        raise PatchError(
            f"{path} has {sum(map(len, others))} faces of type {others[0].type}, without which there would be holes: "
            "cut them into triangles or quadrilaterals"
        )
    cells = {
        name: np.concatenate([np.asarray(arrays[i], dtype=np.float64) for i, _ in blocks])
        for name, arrays in mesh.cell_data.items()
        if blocks
    }
    warn_of_rounded(str(path), points)
    if points.shape[1] == 2:
        points = np.pad(points, ((0, 0), (0, 1)))
    points = np.asarray(points[:, :3], dtype=np.float64)
    if all(block.type in _FACES for _, block in blocks):
        faces = [block.data[:, [0, 1, 2, -1]] for _, block in blocks]
        quads = np.concatenate([np.empty((0, 4), np.int64), *faces]).astype(np.int64)
        return points, quads, np.arange(len(quads)), cells
    return _cut(path, points, polygons_of([block for _, block in blocks]), cells)


def _by_own(path: Path) -> _Read:
    """OFF and OBJ, which meshio reads in part."""
    points, polygons, cells = (read_off if path.suffix.lower() == ".off" else read_obj)(path)
    return _cut(path, points, polygons, cells)


def _cut(path: Path, points: Array, polygons: list[list[int]], cells: dict[str, Array]) -> _Read:
    try:
        return points, *cut_polygons(points, polygons), cells
    except PatchError as error:
        raise PatchError(f"{path}: {error}") from None


def _by_trimesh(path: Path) -> _Read:
    trimesh = library("trimesh", f"reading {path}")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:
        raise PatchError(f"{path} cannot be read as a mesh: {' '.join(str(error).split())}") from error
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    return np.asarray(mesh.vertices, dtype=np.float64), faces[:, [0, 1, 2, 2]], np.arange(len(faces)), {}
