"""Patches from mesh files, read by meshio (PLY, STL, VTK, VTU, VTP, Gmsh and more), trimesh (glTF and more), or here
(OBJ, OFF, View3D, EnergyPlus, CityJSON, Honeybee, Radiance, profiles)."""

from __future__ import annotations

import contextlib
import io
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, library, logger, suggest

from ..errors import PatchError
from ..faces import face_vectors, flat_faces, named_faces, repeated
from ..heat import thermal
from ..orienting import orientation, turned
from ..patches import Patches, warn_of_rounded
from ..revolution import Rings
from ..zones import zone_names
from .buildingfiles import read_building
from .joining import ZONES, joined_files
from .polygons import cut_polygons, grid_of_polydata, polygons_of, read_obj, read_off, stl_solids
from .profilefiles import read_profile
from .radfiles import read_rad
from .surfacefiles import MeshFile
from .view3dfiles import read_vs2, read_vs3

Index = NDArray[np.int64]

#: Supported cell types.
_FACES = ("triangle", "quad")
#: Suffixes that trimesh reads and meshio does not.
_TRIMESH = (".gltf", ".glb", ".3mf", ".dae")
#: Suffixes of text that is read here, and of files that may be VTK's PolyData.
_OWN, _VTK = (".off", ".obj"), (".vtk", ".vtp")
#: Readers of files of named surfaces.
_SURFACES = {
    ".csv": read_profile,
    ".vs2": read_vs2,
    ".vs3": read_vs3,
    ".rad": read_rad,
    ".epjson": read_building,
    ".idf": read_building,
    ".hbjson": read_building,
    ".cityjson": read_building,
    ".json": read_building,
    ".jsonl": read_building,
}


def read_patches(
    path: str | Path,
    *,
    reflectance: ArrayLike | str | None = None,
    emission: ArrayLike | str | None = None,
    temperature: ArrayLike | str | None = None,
    ids: ArrayLike | str | None = None,
    two_sided: ArrayLike = False,
    sky: ArrayLike = 0.0,
    objects: str | None = None,
    more: Sequence[str | Path] = (),
    obstacles: Sequence[str | Path] = (),
    orient: str | None = None,
    zone: str | None = None,
    periodic: Sequence[float] | None = None,
) -> Patches:
    """Patches of a mesh file, with the arguments of :class:`Patches`.

    reflectance, emission, ids: also the name of a cell-data array of the file, with a value for each face; a patch of
        several faces gets their area-weighted mean. For the array ``"emissivity"`` the reflectance is one minus its
        values. Without them, those that the format defines (View3D's emissivities, Radiance's colours), else 0.
        For ids, also ``"groups"``: the first array of the file whose numbers have names, such as ``g``, ``o`` or
        ``usemtl`` of OBJ, ``solid`` of STL, ``gmsh:physical``. Names become those of the ``shapes`` of the patches.
    temperature: in kelvin, in the same forms: patches then emit as grey bodies whose emissivity is one minus the
        reflectance, in W/m^2 (:func:`thermal`).
    objects: an array of the file with the number of an object for each face, negative for walls; the objects become
        the ``shapes`` of the patches, for :func:`find_objects`.
    more, obstacles: further files: of patches, and of faces that only occlude. Of arrays, those are read that all files
        of patches have; ``"file"`` numbers these files, and names them.
    orient: ``"outward"`` turns the faces whose fronts are not outside of solids, ``"inward"`` those whose fronts are
        not inside of rooms (:func:`orientation`); a warning names them.
    zone: of EnergyPlus, or a room of Honeybee: only its patches, without empty ones. Otherwise ``zones`` of the patches
        are their names, if the file has some.
    periodic: see :class:`Patches`. Surfaces of the plane (``.vs2``) go on along y without end anyway.

    A ``.csv`` has the profile of surfaces of revolution (:meth:`Patches.revolved`), with the columns ``name``, ``r1``,
    ``z1``, ``r2``, ``z2`` and, if known, ``emissivity`` and ``temperature``; it takes no further files.

    Reads polygons and ignores lines and solids; polygons of more than four corners become triangles of one patch. Faces
    without area and duplicates are left out with a warning; their patches keep their rows, see ``left_out`` of
    :class:`Patches`. Raises :class:`PatchError` for a file that cannot be read, without faces, with other types of
    faces, or without the named array, and :class:`etendue.core.BackendError` if the library that reads it is not
    installed.
    """
    path = Path(path)
    if temperature is not None and emission is not None and (isinstance(emission, str) or np.any(emission)):
        raise PatchError("patches emit by their temperature or have an emission; give one of the two")
    files = [(name.stem, _read(name)) for name in (path, *map(Path, more))]
    mesh, hidden = files[0][1], list[MeshFile]()
    if more or obstacles:
        hidden = [_read(Path(name)) for name in obstacles]
        mesh = joined_files(files, hidden, is_reflectance_given=reflectance is not None)
        if lost := [name for name in ZONES if name in files[0][1].names and name not in mesh.names]:
            logger.warning(
                "%s: its %ss are not kept beside a further file that has none: give that as an obstacle (--obstacles), "
                "or surfaces of all see each other through gaps",
                *(path, lost[0]),
            )
    for name in (path, *more, *obstacles) if more or obstacles or orient or periodic is not None else ():
        if Path(name).suffix.lower() == ".csv":
            raise PatchError(
                f"{name} is the profile of surfaces of revolution, with its fronts to the left of the way along it: it "
                "takes no further files, no period and no orientation"
            )
    periodic = _period(path, [*(file for _, file in files), *hidden], periodic)
    vertices, faces, rows, cells = mesh.points, mesh.faces, mesh.rows, mesh.cells
    left_out = broken_faces(vertices, faces, str(path), rows=rows)

    count = int(rows[-1]) + 1
    if isinstance(ids, str) and ids == "groups" and ids not in cells:
        ids = next((array for array in mesh.names if array != "surfaces"), None)
        if ids is None:
            raise PatchError(f"{path} has no named groups of faces; name an array of it, or leave out ids")
    given = mesh.ids if ids is None else _cell_array(path, cells, ids, whole=True)
    labels = np.arange(count) if given is None else np.asarray(given)
    seen = np.delete(np.arange(count), mesh.obstacles)
    if len(seen) == 0:
        raise PatchError(f"{path}: all {count} surfaces are obstacles; a radiosity problem needs one patch at least")
    groups, inverse = np.unique(labels[seen], return_inverse=True)
    areas = np.linalg.norm(face_vectors(vertices, faces)[0], axis=1)
    areas[left_out] = 0.0
    areas = np.bincount(rows, areas).astype(np.float64)[seen]

    def of_patches(value: Any, name: str, otherwise: Any = None) -> Any:
        """An array of the file as one of patches; other values stay as they are."""
        if not isinstance(value, str) and value is not None:
            return value
        if value is None and name not in mesh.own:
            return otherwise
        if value is None:
            of_rows = mesh.own[name]
        elif name == "reflectance" and value == "emissivity":
            of_rows = 1 - _cell_array(path, cells, value)
        else:
            of_rows = _cell_array(path, cells, value)
        of_rows = np.asarray(of_rows)[seen]
        return of_rows if given is None else _means(of_rows, inverse.reshape(-1), areas, len(groups))

    zones = None
    if (array := next((name for name in ZONES if name in mesh.names), None)) is not None:
        zones = np.array([mesh.names[array].get(int(k), "") for k in cells[array]], dtype=str)
    kelvin = of_patches(temperature, "temperature")
    patches = Patches(
        vertices,
        faces if orient is None else _oriented(path, vertices, faces, rows, left_out, orient, zones),
        reflectance=of_patches(reflectance, "reflectance", 0.0),
        emission=0.0 if temperature is not None else of_patches(emission, "emission", 0.0),
        ids=labels[rows],
        numbers=rows,
        two_sided=two_sided,
        sky=sky,
        left_out=left_out,
        obstacles=np.flatnonzero(np.isin(rows, mesh.obstacles)),
        periodic=periodic,
        rings=None if mesh.profile is None else Rings(mesh.profile, rows),
    )
    firsts = np.cumsum([0, *(int(m.rows[-1]) + 1 if len(m.rows) else 0 for _, m in files[:-1])])
    patches.files = tuple((name, int(first)) for (name, _), first in zip(files, firsts, strict=True))
    if objects is not None:
        numbers = _cell_array(path, cells, objects, whole=True)[seen]
        if not _set_shapes(patches, labels[seen], numbers):
            raise PatchError(
                f"{path}, array '{objects}': {_torn(labels[seen], numbers)}; a patch belongs to one object"
            )
    else:
        for array in [ids] if isinstance(ids, str) else mesh.names:
            if array in mesh.names and _set_shapes(patches, labels[seen], cells[array][seen], mesh.names[array]):
                break
    if zones is not None:
        patches.zones = _zones(labels[seen], zones[seen], patches.labels)
    if temperature is not None:
        patches = _warm(patches, np.asarray(kelvin, dtype=np.float64).ravel(), sky)
    if zone is None:
        return patches
    known = zone_names(patches)
    matching = next((name for name in known if name.lower() == zone.lower()), None)
    if matching is None:
        raise PatchError(f"{path} has no zone '{zone}'; " + (suggest(zone, known) if known else "it has no zones"))
    return patches.only(patches.zones == matching, obstacles=True)[0]


def _zones(labels: Index, zones: NDArray[np.str_], patches: Index) -> NDArray[np.str_]:
    """The zone of each patch from those of the faces; empty for one with faces of several zones."""
    names, number = np.unique(zones, return_inverse=True)
    known, low, high = _extremes(labels, number)
    return np.where(low == high, names[low], "")[np.searchsorted(known, patches)]


def _oriented(
    path: Path,
    vertices: Array,
    faces: Index,
    rows: Index,
    left_out: Index,
    orient: str,
    zones: NDArray[np.str_] | None,
) -> Index:
    """The faces with their fronts outward or inward; zones: of rows."""
    if orient not in ("outward", "inward"):
        raise PatchError(f"faces are turned outward or inward, not '{orient}'")
    patches = Patches(vertices, faces, numbers=rows, left_out=left_out)
    patches.zones = None if zones is None else zones[patches.face]
    found = orientation(patches, inward=orient == "inward")
    for which, what in ((found.wrong, "turned"), (found.undecided, "left as they are, both sides being alike")):
        if len(which):
            logger.warning(
                "%s: of %d faces %d are %s: face %s (counted from 0)",
                *(path, rows[-1] + 1, len(which)),
                what,
                named_faces(which),
            )
    return np.where(np.isin(rows, found.wrong)[:, None], turned(faces), faces)


def may_have_zones(path: Path) -> bool:
    """Whether a mesh file is of a building that may have zones."""
    return _SURFACES.get(path.suffix.lower()) is read_building


def is_mesh_file(path: Path) -> bool:
    """Whether a file has the suffix of a mesh that is no model of a scene, such as ``.vtu`` or ``.vs3``."""
    suffix = path.suffix.lower()
    return suffix in _SURFACES or suffix in _VTK or suffix in (".vtu", ".msh", ".dae", ".3mf")


def _period(path: Path, meshes: Sequence[MeshFile], given: Sequence[float] | None) -> Sequence[float] | None:
    """The period that is given, and that of files which repeat their surfaces themselves."""
    periods = {mesh.period for mesh in meshes}
    if periods == {None}:
        return given
    if len(periods) > 1:
        raise PatchError(f"{path}: surfaces of a plane (.vs2) and of space cannot be in one run")
    if given is not None and (len(given) != 2 or given[1]):
        raise PatchError(f"{path} goes on along y already: give the period LX,0 for a repetition along x")
    own = meshes[0].period
    assert own is not None
    return own if given is None else (given[0], own[1])


def _read(path: Path) -> MeshFile:
    """The mesh of a file. Raises :class:`PatchError`."""
    if not path.is_file():
        raise PatchError(f"there is no mesh file {path}")
    if path.stat().st_size == 0:
        raise PatchError(f"{path} is empty")
    suffix = path.suffix.lower()
    read = _SURFACES.get(suffix) or (_by_trimesh if suffix in _TRIMESH else _by_own if suffix in _OWN else _by_meshio)
    mesh = read(path)
    if len(mesh.faces) == 0:
        raise PatchError(f"{path} has no triangles or quadrilaterals")
    return mesh


def _set_shapes(patches: Patches, labels: Index, numbers: NDArray[Any], names: Mapping[int, str] | None = None) -> bool:
    """The object of each patch, from the numbers of the faces and the labels of their patches; negative for none.
    ``False`` for a patch with faces of several objects."""
    known, low, high = _extremes(labels, numbers)
    if (low != high).any():
        return False
    number = low[np.searchsorted(known, patches.labels)]
    objects = np.unique(number[number >= 0])
    patches.shapes = np.where(number < 0, -1, np.searchsorted(objects, number))
    patches.shape_names = tuple(str(k) if names is None else names.get(int(k), str(k)) for k in objects)
    return True


def _torn(labels: Index, numbers: NDArray[Any]) -> str:
    """The first patch with faces of two objects, in words."""
    known, low, high = _extremes(labels, numbers)
    k = np.flatnonzero(low != high)[0]
    return f"patch {known[k]} has faces of the objects {low[k]} and {high[k]}"


def _extremes(labels: Index, numbers: NDArray[Any]) -> tuple[Index, Index, Index]:
    """The labels, and the smallest and largest number of each."""
    known, patch = np.unique(labels, return_inverse=True)
    whole = np.rint(numbers).astype(np.int64).ravel()
    low, high = np.full(len(known), whole.max()), np.full(len(known), whole.min())
    np.minimum.at(low, patch.reshape(-1), whole)
    np.maximum.at(high, patch.reshape(-1), whole)
    return known, low, high


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
        quads, halves = flat_faces(vertices, faces, rows)
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
        doubled = len(np.intersect1d(gone, of[twice]))
        logger.warning(
            "%s: of %d faces %d have no area and %d are duplicates; they are left out%s: face %s (counted from 0)",
            *(where, of[-1] + 1, len(gone) - doubled, doubled, then, named_faces(gone)),
        )
    return left_out


def _cell_array(path: Path, cells: Mapping[str, Array], value: Any, whole: bool = False) -> Any:
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


def _by_meshio(path: Path) -> MeshFile:
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
        read = MeshFile(points=points, faces=quads, rows=np.arange(len(quads)), cells=cells)
    else:
        read = _cut(path, points, polygons_of([block for _, block in blocks]), cells)
    return replace(read, names=_names_of(path, mesh, read))


def _names_of(path: Path, mesh: Any, read: MeshFile) -> dict[str, dict[int, str]]:
    """Names of groups of faces in a file that meshio has read: of Gmsh's physical groups, and of the solids of STL."""
    physical = {int(number): name for name, (number, dimension) in mesh.field_data.items() if dimension == 2}
    if "gmsh:physical" in read.cells and physical:
        return {"gmsh:physical": physical}
    if path.suffix.lower() == ".stl" and (solids := stl_solids(path)) and len(solids[0]) == len(read.rows):
        read.cells["solid"] = np.array(solids[0])
        return {"solid": dict(enumerate(solids[1]))}
    return {}


def _by_own(path: Path) -> MeshFile:
    """OFF and OBJ, which meshio reads in part."""
    points, polygons, cells, names = (read_off if path.suffix.lower() == ".off" else read_obj)(path)
    return replace(_cut(path, points, polygons, cells), names=names)


def _cut(path: Path, points: Array, polygons: list[list[int]], cells: dict[str, Array]) -> MeshFile:
    try:
        faces, rows = cut_polygons(points, polygons)
        return MeshFile(points=points, faces=faces, rows=rows, cells=cells)
    except PatchError as error:
        raise PatchError(f"{path}: {error}") from None


def _by_trimesh(path: Path) -> MeshFile:
    trimesh = library("trimesh", f"reading {path}")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:
        raise PatchError(f"{path} cannot be read as a mesh: {' '.join(str(error).split())}") from error
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    points = np.asarray(mesh.vertices, dtype=np.float64)
    return MeshFile(points=points, faces=faces[:, [0, 1, 2, 2]], rows=np.arange(len(faces)))
