"""Patches as a mesh file of their faces, with the names of their groups."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError
from etendue.film import replacing
from etendue.formats import write_mesh

from .faces import triangles
from .patches import Patches

_SUFFIXES = (".obj", ".stl", ".ply", ".vtu")
#: The group of faces that only occlude, in files with groups.
_OBSTACLES = "obstacles"


def check_patch_file(path: str | os.PathLike[str]) -> Path:
    """The path of a file of :func:`save_patches`. Raises :class:`OptionError`."""
    checked = Path(path)
    if checked.suffix.lower() not in _SUFFIXES:
        raise OptionError(f"a mesh is written as {', '.join(_SUFFIXES)}, not as '{checked.name}'; change the name")
    return checked


def save_patches(path: str | os.PathLike[str], patches: Patches) -> None:
    """Write the faces of patches, their fronts as they are: ``.obj`` with a group ``g`` for each name, ``.stl`` with a
    ``solid`` for each, ``.ply``, or ``.vtu`` with the number of the ``face`` in the file that was read, as an array.

    Polygons of more than four corners are cut into triangles, in ``.stl`` all. Raises :class:`OptionError` for another
    suffix, :class:`etendue.core.OutputError` if the file cannot be written."""
    path = check_patch_file(path)
    suffix = path.suffix.lower()
    if suffix in (".ply", ".vtu"):
        numbers = {} if suffix == ".ply" else {"face": patches.numbers}
        write_mesh(path, suffix[1:], patches.vertices, patches.faces, {}, numbers)
        return
    lines = _obj(patches) if suffix == ".obj" else _stl(patches)
    with replacing(path) as part, part.open("w", encoding="utf-8") as file:
        file.writelines(lines)


def _groups(patches: Patches) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """The name of each group and its faces; first those of none, since in OBJ a group lasts until the next."""
    names = np.where(patches.front < 0, _OBSTACLES, patches.names[patches.front])
    for name in sorted(dict.fromkeys(names.tolist()), key=bool):
        yield name, np.flatnonzero(names == name)


def _obj(patches: Patches) -> Iterator[str]:
    for x, y, z in patches.vertices.tolist():
        yield f"v {x!r} {y!r} {z!r}\n"
    for name, members in _groups(patches):
        if name:
            yield f"g {name}\n"
        for face in (patches.faces[members] + 1).tolist():
            yield f"f {' '.join(map(str, face[:3] if face[2] == face[3] else face))}\n"


def _stl(patches: Patches) -> Iterator[str]:
    for name, members in _groups(patches):
        yield f"solid {name or 'mesh'}\n"
        corners, of = triangles(patches.faces[members])
        for triangle, normal in zip(corners[np.argsort(of, kind="stable")], np.sort(of), strict=True):
            x, y, z = patches.face_normals[members[normal]].tolist()
            yield f"facet normal {x:.9g} {y:.9g} {z:.9g}\n outer loop\n"
            for a, b, c in patches.vertices[triangle].tolist():
                yield f"  vertex {a!r} {b!r} {c!r}\n"
            yield " endloop\nendfacet\n"
        yield f"endsolid {name or 'mesh'}\n"
