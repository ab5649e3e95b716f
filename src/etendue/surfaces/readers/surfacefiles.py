"""Files of named surfaces, each a polygon that may have others in it: what their readers return, and its faces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from ..errors import PatchError
from ..faces import flat_faces
from .cutting import cut_out
from .polygons import cut_polygons

Index = NDArray[np.int64]


@dataclass(kw_only=True)
class MeshFile:
    """What a file of a mesh has.

    A *row* is a face of the file, of which ``faces`` may be parts. points: (v, 3). faces: (f, 4), a triangle repeats
    its last index. rows: (f,). cells: arrays with an entry for each row, by name. names: of such arrays of numbers, the
    names of the numbers. ids: (rows,) the patch of each row, if it is not a patch of its own. obstacles: rows that only
    occlude. own: values of rows that the format defines, by their names in :class:`Patches`. period: of a domain that
    the format repeats without end, see :class:`Patches`. profile: (rows, 4) of rings, see :meth:`Patches.revolved`.
    """

    points: Array
    faces: Index
    rows: Index
    cells: dict[str, Array] = field(default_factory=dict)
    names: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    ids: Index | None = None
    obstacles: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    own: Mapping[str, Array] = field(default_factory=dict)
    period: tuple[float, float] | None = None
    profile: Array | None = None


@dataclass(kw_only=True)
class Surface:
    """A polygon (k, 3) of a file, counterclockwise seen from its front.

    where: its place in the file, for messages. holes: polygons that are cut out; those of other surfaces are in
    ``inside``. one_with: another surface that is the same patch. obstacle: whether it only occludes. groups: the name
    of the group that it belongs to, by kind. values: of the arrays of the mesh.
    """

    outline: Array
    name: str
    where: str
    holes: list[Array] = field(default_factory=list)
    inside: list[Surface] = field(default_factory=list)
    one_with: Surface | None = None
    obstacle: bool = False
    groups: dict[str, str] = field(default_factory=dict)
    values: dict[str, Any] = field(default_factory=dict)


def mesh_of(path: Path, surfaces: list[Surface], own: Mapping[str, Array] | None = None) -> MeshFile:
    """The faces of surfaces, in their order. Raises :class:`PatchError` for one that is no polygon, or does not
    contain those inside it."""
    points: list[Array] = []
    polygons: list[list[int]] = []
    rows: list[int] = []
    for surface in surfaces:
        for ring, what in [(surface.outline, ""), *((hole, "a hole of ") for hole in surface.holes)]:
            if len(ring) < 3:
                raise PatchError(
                    f"{path}, {surface.where}: {what}'{surface.name}' has {len(ring)} corners; it needs three"
                )
    for row, surface in enumerate(surfaces):
        pieces = _cut(path, surface) if surface.holes or surface.inside else [surface.outline]
        # A surface of which nothing is left keeps its row, as a face without area.
        for piece in pieces or [surface.outline[[0, 0, 0]]]:
            start = sum(map(len, points[-1:])) + (polygons[-1][0] if polygons else 0)
            points.append(piece)
            polygons.append(list(range(start, start + len(piece))))
            rows.append(row)
    corners = np.concatenate([np.zeros((0, 3)), *points])
    try:
        faces, part = cut_polygons(corners, polygons)
    except PatchError:
        bad = next(k for k, polygon in enumerate(polygons) if len(polygon) > 4 and not _is_simple(corners, polygon))
        surface = surfaces[rows[bad]]
        raise PatchError(f"{path}, {surface.where}: '{surface.name}' crosses itself") from None
    for row in _crossing(corners, faces, np.array(rows, dtype=np.int64)[part]):
        raise PatchError(f"{path}, {surfaces[row].where}: '{surfaces[row].name}' crosses itself")
    number = {id(surface): row for row, surface in enumerate(surfaces)}
    arrays = {name: np.array([s.values[name] for s in surfaces]) for name in (surfaces[0].values if surfaces else ())}
    names: dict[str, dict[int, str]] = {"surfaces": {row: surface.name for row, surface in enumerate(surfaces)}}
    ids = np.array([number[id(s.one_with or s)] for s in surfaces], dtype=np.int64)
    arrays["surfaces"] = ids
    for kind in surfaces[0].groups if surfaces else ():
        known: dict[str, int] = {}
        arrays[kind] = np.array([known.setdefault(surface.groups[kind], len(known)) for surface in surfaces])
        names[kind] = {k: name for name, k in known.items()}
    return MeshFile(
        points=corners,
        faces=faces,
        rows=np.array(rows, dtype=np.int64)[part],
        cells=arrays,
        names=names,
        ids=ids,
        obstacles=np.flatnonzero([surface.obstacle for surface in surfaces]),
        own=own or {},
    )


def _cut(path: Path, surface: Surface) -> list[Array]:
    """What is left of a surface without what is inside it."""
    name = f"'{surface.name}'"
    holes = [(f"{path}, {surface.where}: a hole of {name}", hole) for hole in surface.holes]
    holes += [(f"{path}, {inner.where}: '{inner.name}' in {name}", inner.outline) for inner in surface.inside]
    return cut_out(f"{path}, {surface.where}: {name}", surface.outline, holes)


def _crossing(points: Array, faces: Index, rows: Index) -> Iterator[int]:
    """Rows of quadrilaterals that cross themselves."""
    try:
        if len(faces):
            flat_faces(points, faces)
    except PatchError:
        for face, row in zip(faces, rows, strict=True):
            try:
                flat_faces(points, face[None])
            except PatchError:
                yield int(row)


def _is_simple(points: Array, polygon: list[int]) -> bool:
    try:
        cut_polygons(points, [polygon])
    except PatchError:
        return False
    return True


def corners_of(value: Any, what: str) -> Array:
    """A polygon (k, 3) from rows of three numbers. Raises :class:`PatchError`."""
    try:
        corners = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        corners = np.zeros(0)
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.isfinite(corners).all():
        raise PatchError(f"{what} is no list of points of three numbers")
    return corners
