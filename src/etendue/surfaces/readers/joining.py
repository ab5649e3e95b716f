"""Several mesh files as one: patches of some, and obstacles of others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from etendue.core import Array

from ..errors import PatchError
from .surfacefiles import MeshFile

#: The array that numbers the files, and the one whose numbers are those of surfaces, which no two files share.
FILE, _SURFACES = "file", "surfaces"


def joined_files(files: Sequence[tuple[str, MeshFile]], obstacles: Sequence[MeshFile] = ()) -> MeshFile:
    """The faces of ``files`` (name, mesh) and of ``obstacles``, which only occlude.

    Arrays are those that all of ``files`` have, and ``"file"``; groups of the same name are one group. Raises
    :class:`PatchError` for values of a format that some of the files have and others do not."""
    meshes = [mesh for _, mesh in files]
    every = [*meshes, *obstacles]
    counts = [int(mesh.rows[-1]) + 1 if len(mesh.rows) else 0 for mesh in every]
    first = np.cumsum([0, *counts])
    corner = np.cumsum([0, *(len(mesh.points) for mesh in every)])
    for name in {name for mesh in meshes for name in mesh.own}:
        if lacking := next((file for file, mesh in files if name not in mesh.own), None):
            raise PatchError(f"{lacking} has no {name} as other files have; give the {name} of all")
    unseen = sum(counts[len(meshes) :])

    def all_rows(arrays: Sequence[Array]) -> Array:
        """An entry for each row, zero for obstacles."""
        whole = np.concatenate(arrays)
        return np.concatenate([whole, np.zeros((unseen, *whole.shape[1:]), whole.dtype)])

    shared = [name for name in meshes[0].cells if all(name in mesh.cells for mesh in meshes)]
    cells, names = {}, {}
    for name in shared:
        arrays = [mesh.cells[name] for mesh in meshes]
        if name == _SURFACES:
            arrays = [array + start for array, start in zip(arrays, first, strict=False)]
            known = {
                int(k + start): v for m, start in zip(meshes, first, strict=False) for k, v in m.names[name].items()
            }
            names[name] = known
        elif all(name in mesh.names for mesh in meshes):
            numbers: dict[str, int] = {}
            for k, mesh in enumerate(meshes):
                words = [mesh.names[name].get(int(number), str(int(number))) for number in arrays[k]]
                arrays[k] = np.array([numbers.setdefault(word, len(numbers)) for word in words])
            names[name] = {number: word for word, number in numbers.items()}
        cells[name] = all_rows(arrays)
    cells[FILE] = all_rows([np.full(count, k) for k, count in enumerate(counts[: len(meshes)])])
    names[FILE] = {k: name for k, (name, _) in enumerate(files)}
    hidden = [mesh.obstacles + start for mesh, start in zip(meshes, first, strict=False)]
    patch = [np.arange(n) if mesh.ids is None else mesh.ids for mesh, n in zip(every, counts, strict=True)]
    return MeshFile(
        points=np.concatenate([mesh.points for mesh in every]),
        faces=np.concatenate([mesh.faces + start for mesh, start in zip(every, corner, strict=False)]),
        rows=np.concatenate([mesh.rows + start for mesh, start in zip(every, first, strict=False)]),
        cells=cells,
        names=names,
        ids=np.concatenate([ids + start for ids, start in zip(patch, first, strict=False)])
        if any(mesh.ids is not None for mesh in every)
        else None,
        obstacles=np.concatenate([*hidden, np.arange(first[len(meshes)], first[-1])]),
        own={name: all_rows([mesh.own[name] for mesh in meshes]) for name in meshes[0].own},
    )
