"""Faces of any number of corners: cut into triangles; and files that meshio does not read or reads in part."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from ..errors import PatchError

Index = NDArray[np.int64]
#: Vertices, polygons, arrays by face, and of some arrays the names of their numbers.
_Polygons = tuple[Array, list[list[int]], dict[str, Array], dict[str, dict[int, str]]]

#: Statements of OBJ that group faces by names.
_GROUPS = ("g", "o", "usemtl")
#: Types of cells of VTK: polygons.
_POLYGON = 7
#: Types of arrays by which version 5.1 of the format is read, for those of C; and the lines that name a type.
_SIZES = {b"char": 8, b"short": 16, b"int": 32, b"long": 64}
_WORDS = {word: b"vtktypeint%d" % size for word, size in _SIZES.items()}
_WORDS |= {b"unsigned_" + word: b"vtktypeuint%d" % size for word, size in _SIZES.items()}
_ARRAY = re.compile(
    rb"^((?:SCALARS \S+|\S+ \d+ \d+) )((?:unsigned_)?(?:char|short|int|long))( \d+)?(?=[ \t\r]*$)", re.M
)
#: Depth of a crossing of a polygon with itself that counts as none, as an area in units of the squared size: cities are
#: rounded to millimetres.
_TOUCHING = 1e-4
#: Area of a corner that counts as straight, in the same units, and of triangles of a rest that is dropped if no ear is
#: left, in those of the rest: a spike that a rounded polygon runs to and fro.
_STRAIGHT, _THIN = 1e-12, 1e-3
#: Sections of VTK's PolyData that are no polygons.
_NO_POLYGONS = {b"VERTICES": "vertices", b"LINES": "lines", b"TRIANGLE_STRIPS": "triangle strips"}


def cut_polygons(points: Array, polygons: list[list[int]]) -> tuple[Index, Index]:
    """Faces (f, 4) of polygons, a triangle repeats its last index, and the polygon of each face.

    Triangles and quadrilaterals stay whole, other polygons are cut into triangles. Raises :class:`PatchError` for a
    polygon of fewer than three corners, for unknown corners, and for one that crosses itself.
    """
    faces: list[list[int]] = []
    rows: list[int] = []
    for row, corners in enumerate(polygons):
        bad = next((k for k in corners if not 0 <= k < len(points)), None)
        if bad is not None:
            raise PatchError(f"face {row} names vertex {bad}, but there are {len(points)} vertices")
        if len(corners) < 3:
            raise PatchError(f"face {row} has {len(corners)} corners; it needs three")
        parts = [[*corners, corners[-1]][:4]]
        if len(corners) > 4:
            triangles = ears(points[corners])
            if triangles is None:
                raise PatchError(f"face {row} of {len(corners)} corners crosses itself: cut it into triangles")
            # A polygon without area keeps its row, as a face without area.
            parts = [[corners[a], corners[b], corners[c], corners[c]] for a, b, c in triangles or [(0, 0, 0)]]
        faces += parts
        rows += [row] * len(parts)
    return np.array(faces, dtype=np.int64).reshape(-1, 4), np.array(rows, dtype=np.int64)


def ears(corners: Array) -> list[tuple[int, int, int]] | None:
    """Triangles of a polygon (k, 3), as numbers of corners, cut off one by one as ears: at convex corners whose
    triangle contains no other corner, the best shaped first. Corners that repeat the one before count as one. ``None``
    for a polygon that crosses itself."""
    turned = np.roll(corners, -1, axis=0)
    normal = np.cross(corners - corners[0], turned - corners[0]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(corners, axis, axis=1) * [1.0, 1.0 if (normal[axis] > 0) == (axis != 1) else -1.0]
    left = np.flatnonzero((corners != np.roll(corners, 1, axis=0)).any(axis=1)).tolist()
    if len(left) < 3:
        return []
    if _crosses_itself(flat[left]):
        return None
    least, triangles = _STRAIGHT * np.ptp(flat, axis=0).max() ** 2, []
    while len(left) > 3:
        ring = np.array(left)
        a, b, c = flat[np.roll(ring, 1)], flat[ring], flat[np.roll(ring, -1)]
        area = _area(a, b, c)
        longest = np.maximum.reduce([((x - y) ** 2).sum(axis=1) for x, y in ((a, b), (b, c), (c, a))])
        quality = area / np.maximum(longest, np.finfo(float).tiny)  # corners may coincide
        # An ear whose base runs through corners on a straight edge would leave them without area. Seams to holes have
        # corners twice, and if there is no other ear, those at its corners do not count.
        for bent, margin in ((ring[area <= least], -least), (ring[area < 0], 0.0), (ring[area < 0], least)):
            ear = next(
                (k for k in np.argsort(-quality) if area[k] > least and _is_ear(flat, ring, k, bent, margin)), None
            )
            if ear is not None:
                triangles.append((int(ring[ear - 1]), int(ring[ear]), int(ring[(ear + 1) % len(ring)])))
                left.pop(ear)
                break
        else:
            rest = flat[left]
            is_thin = np.abs(_area(rest[0], rest[1:-1], rest[2:])) <= _THIN * np.ptp(rest, axis=0).max() ** 2
            return triangles if is_thin.all() else None
    return [*triangles, (left[0], left[1], left[2])]


def _is_ear(flat: Array, ring: Index, k: int, bent: Index, margin: float) -> bool:
    """Whether the triangle at corner ``k`` of a ring contains none of the corners ``bent``, by a ``margin``."""
    ear = ring[[k - 1, k, (k + 1) % len(ring)]]
    others = flat[np.setdiff1d(bent, ear)]
    inside = np.ones(len(others), dtype=bool)
    for start, end in zip(ear, np.roll(ear, -1), strict=True):
        inside &= _area(flat[start], flat[end], others) >= margin
    return not inside.any()


def _crosses_itself(flat: Array) -> bool:
    """Whether two edges of a polygon (k, 2) cross, that is, have the ends of each other on both sides."""
    side = _area(flat[:, None], np.roll(flat, -1, axis=0)[:, None], flat)
    side[np.abs(side) < _TOUCHING * np.ptp(flat, axis=0).max() ** 2] = 0.0
    is_cut = side * np.roll(side, -1, axis=1) < 0
    return bool((is_cut & is_cut.T).any())


def _area(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed area of triangles in the plane."""
    one, other = b - a, c - a
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def read_off(path: Path) -> _Polygons:
    """Vertices and polygons of an OFF file; colours are ignored."""
    lines = [line.split("#")[0].split() for line in path.read_text("utf-8").splitlines()]
    lines = [words for words in lines if words]
    if not lines or not lines[0][0].upper().endswith("OFF"):
        raise PatchError(f"{path} cannot be read as a mesh: it does not begin with OFF")
    kind = lines[0].pop(0).upper()
    if kind not in ("OFF", "COFF", "NOFF", "CNOFF"):
        raise PatchError(
            f"{path} cannot be read as a mesh: {kind} is not known, only OFF of vertices in three dimensions"
        )
    lines = lines if lines[0] else lines[1:]
    try:
        vertices, faces = int(lines[0][0]), int(lines[0][1])
        if len(lines) < 1 + vertices + faces:
            raise PatchError(
                f"{path} is cut off: it has {len(lines) - 1} lines for {vertices} vertices and {faces} faces"
            )
        points = np.array([words[:3] for words in lines[1 : 1 + vertices]], dtype=np.float64).reshape(vertices, 3)
        rows = lines[1 + vertices : 1 + vertices + faces]
        return points, [[int(words[1 + k]) for k in range(int(words[0]))] for words in rows], {}, {}
    except IndexError:
        raise PatchError(f"{path} cannot be read as a mesh: a line has too few numbers") from None
    except ValueError as error:
        raise PatchError(f"{path} cannot be read as a mesh: {error}") from error


def read_obj(path: Path) -> _Polygons:
    """Vertices and polygons of an OBJ file, the array ``obj:group_ids``: the number of the group (``g``) of each
    face, from 0, or -1 before the first; and ``g``, ``o`` and ``usemtl`` with their names, as far as there are."""
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    groups: list[float] = []
    group = -1
    known: dict[str, dict[str, int]] = {kind: {} for kind in _GROUPS}
    current, numbered = dict.fromkeys(_GROUPS, -1), {kind: list[int]() for kind in _GROUPS}
    try:
        for words in map(str.split, path.read_text("utf-8", errors="replace").replace("\\\n", " ").splitlines()):
            if words[:1] == ["v"]:
                points.append([float(word) for word in words[1:4]])
            elif words and words[0] in _GROUPS:
                group += words[0] == "g"
                current[words[0]] = known[words[0]].setdefault(" ".join(words[1:]), len(known[words[0]]))
            elif words[:1] == ["f"]:
                numbers = [int(word.split("/")[0]) for word in words[1:] if not word.startswith("#")]
                # Negative numbers count back from the last vertex so far.
                polygons.append([k - 1 if k >= 0 else len(points) + k for k in numbers])
                groups.append(group)
                for kind in _GROUPS:
                    numbered[kind].append(current[kind])
        vertices = np.array(points, dtype=np.float64).reshape(len(points), 3)
    except ValueError as error:
        raise PatchError(f"{path} cannot be read as a mesh: {error}") from error
    cells = {"obj:group_ids": np.array(groups)}
    used = [kind for kind in _GROUPS if max(numbered[kind], default=-1) >= 0]
    names = {kind: {k: name for name, k in known[kind].items()} for kind in used}
    cells |= {kind: np.array(numbered[kind]) for kind in names}
    return vertices, polygons, cells, names


def stl_solids(path: Path) -> tuple[list[int], list[str]] | None:
    """The solid of each face of an STL file of text, and the names of the solids; ``None`` for a binary file."""
    data = path.read_bytes()
    if not data.lstrip().startswith(b"solid") or b"facet" not in data[:4096]:
        return None
    known: dict[str, int] = {}
    of_faces: list[int] = []
    current = -1
    for words in map(str.split, data.decode("utf-8", errors="replace").splitlines()):
        if words[:1] == ["solid"]:
            current = known.setdefault(" ".join(words[1:]), len(known))
        elif words[:1] == ["facet"]:
            of_faces.append(current)
    return of_faces, list(known)


def grid_of_polydata(path: Path, data: bytes) -> bytes | None:
    """The content of a file of VTK's PolyData (``.vtp``, or legacy ``.vtk``) as that of an unstructured grid, which
    meshio reads; ``None`` for another file. Raises :class:`PatchError` for lines and the like beside polygons."""
    if path.suffix.lower() == ".vtp":
        return _xml_grid(path, data)
    return _legacy_grid(path, data) if re.search(rb"^DATASET\s+POLYDATA", data[:1024], re.M) else None


def _xml_grid(path: Path, data: bytes) -> bytes:
    for name in (b"Verts", b"Lines", b"Strips"):
        count = re.search(rb"NumberOf" + name + rb'="\s*(\d+)', data)
        if count and int(count[1]):
            raise PatchError(f"{path} has {name.decode().lower()} beside polygons: save the polygons only")
        data = re.sub(rb"<" + name + rb">.*?</" + name + rb">", b"", data, flags=re.S)
    polygons = re.search(rb'NumberOfPolys="\s*(\d+)', data)
    if polygons is None:
        raise PatchError(f"{path} cannot be read as a mesh: it has no polygons of VTK")
    types = b'<DataArray type="UInt8" Name="types" format="ascii">' + b"%d " % _POLYGON * int(polygons[1])
    for old, new in (
        (b"NumberOfPolys", b"NumberOfCells"),
        (b"PolyData", b"UnstructuredGrid"),
        (b"<Polys>", b"<Cells>" + types + b"</DataArray>"),
        (b"</Polys>", b"</Cells>"),
    ):
        data = data.replace(old, new)
    return data


def _legacy_grid(path: Path, data: bytes) -> bytes:
    for name, what in _NO_POLYGONS.items():
        if re.search(rb"^" + name + rb"\s+\d+\s+\d+\s*$", data, re.M):
            raise PatchError(f"{path} has {what} beside polygons: save the polygons only")
    found = re.search(rb"^POLYGONS\s+(\d+)\s+(\d+)[ \t\r]*\n", data, re.M)
    if found is None:
        raise PatchError(f"{path} has no triangles or quadrilaterals")
    starts, corners, end = _legacy_polygons(data, found)
    is_text = _is_text(data)

    def written(values: Index, kind: str) -> bytes:
        return (" ".join(map(str, values)).encode() if is_text else values.astype(f">{kind}").tobytes()) + b"\n"

    # As version 5.1, for which meshio keeps the arrays of polygons.
    head = re.sub(rb"^(# vtk DataFile Version) .*", rb"\1 5.1", data[: found.start()], count=1)
    return b"".join(
        [
            head.replace(b"POLYDATA", b"UNSTRUCTURED_GRID", 1),
            b"CELLS %d %d\nOFFSETS vtktypeint64\n" % (len(starts), len(corners)) + written(starts, "i8"),
            b"CONNECTIVITY vtktypeint64\n" + written(corners, "i8"),
            b"CELL_TYPES %d\n" % (len(starts) - 1) + written(np.full(len(starts) - 1, _POLYGON), "i4"),
            _ARRAY.sub(lambda line: line[1] + _WORDS[line[2]] + (line[3] or b""), data[end:].lstrip(b"\r\n")),
        ]
    )


def _is_text(data: bytes) -> bool:
    return re.search(rb"^ASCII", data[:1024], re.M) is not None


def _legacy_polygons(data: bytes, found: re.Match[bytes]) -> tuple[Index, Index, int]:
    """First corner of each polygon and the number of all, the corners, and where the section ends. Raises
    :class:`ValueError` for a damaged section."""
    end = found.end()
    parts = []
    is_new = data[end : end + 64].lstrip().startswith(b"OFFSETS")
    for size in (int(found[1]), int(found[2])) if is_new else (int(found[2]),):
        kind = b"int"
        if is_new:
            line = re.compile(rb"\s*[A-Z]+\s+(\w+)[ \t\r]*\n").match(data, end)
            if line is None:
                raise ValueError("its polygons are damaged")
            kind, end = line[1], line.end()
        if _is_text(data):
            text = re.compile(rb"(?:\s*-?\d+){%d}" % size).match(data, end)
            if text is None:
                raise ValueError(f"it has fewer than {size} numbers for polygons")
            parts.append(np.array(text[0].split(), dtype=np.int64))
            end = text.end()
        else:
            kept = np.frombuffer(data, ">i8" if kind.endswith(b"64") else ">i4", size, end)
            parts.append(kept.astype(np.int64))
            end += kept.nbytes
    if is_new:
        return parts[0], parts[1], end
    (numbers,) = parts
    starts, corners, place = [0], [], 0
    for _ in range(int(found[1])):
        count = int(numbers[place])
        corners.append(numbers[place + 1 : place + 1 + count])
        starts.append(starts[-1] + count)
        place += 1 + count
    return np.array(starts), np.concatenate(corners) if corners else np.empty(0, np.int64), end


def polygons_of(blocks: list[Any]) -> list[list[int]]:
    """The faces of blocks of cells, as lists of corners."""
    return [row for block in blocks for row in np.asarray(block.data).tolist()]
