"""Several mesh files as one: patches of some, and obstacles of others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from etendue.core import Array

from ..errors import PatchError
from .surfacefiles import MeshFile

#: The array that numbers the files, and the one whose numbers are those of surfaces, which no two files share.
FILE, _SURFACES = "file", "surfaces"
#: Arrays whose groups are zones: surfaces of different ones exchange no light.
ZONES = ("zone", "room")


def joined_files(
    files: Sequence[tuple[str, MeshFile]], obstacles: Sequence[MeshFile] = (), is_reflectance_given: bool = False
) -> MeshFile:
    """The faces of ``files`` (name, mesh) and of ``obstacles``, which only occlude.

    Arrays are those that all of ``files`` have, and ``"file"``; groups of the same name are one group, but zones
    are apart, as ``file: zone``. Files without emission do not emit. Raises :class:`PatchError` for
    reflectances that some of the files have and others do not, unless they are given in place of these."""
    meshes = [mesh for _, mesh in files]
    every = [*meshes, *obstacles]
    counts = [int(mesh.rows[-1]) + 1 if len(mesh.rows) else 0 for mesh in every]
    first = np.cumsum([0, *counts])
    corner = np.cumsum([0, *(len(mesh.points) for mesh in every)])
    own = {name for mesh in meshes for name in mesh.own}
    lacking = next((file for file, mesh in files if "reflectance" not in mesh.own), None)
    if "reflectance" in own and lacking is not None and not is_reflectance_given:
        raise PatchError(f"{lacking} has no reflectance as other files have; give the reflectance of all")
    unseen = sum(counts[len(meshes) :])

    def all_rows(arrays: Sequence[Array]) -> Array:
        """An entry for each row, zero for obstacles."""
        whole = np.concatenate(arrays)
        return np.concatenate([whole, np.zeros((unseen, *whole.shape[1:]), whole.dtype)])

    def own_values(name: str) -> Array:
        """Of one channel if all files have one, else with that for all channels."""
        every = [np.reshape(m.own.get(name, np.zeros(n)), (n, -1)) for m, n in zip(meshes, counts, strict=False)]
        channels = max(values.shape[1] for values in every)
        return all_rows([np.broadcast_to(values, (len(values), channels)) for values in every])

    shared = [
        name
        for name, array in meshes[0].cells.items()
        if all(name in mesh.cells and mesh.cells[name].shape[1:] == array.shape[1:] for mesh in meshes)
    ]
    given = [file for file, _ in files]
    called = [file if given.count(file) == 1 else f"{file} {k}" for k, file in enumerate(given, 1)]
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
            twice = _names_of_several(meshes, name) if name in ZONES else ()
            for k, mesh in enumerate(meshes):
                words = [mesh.names[name].get(int(k), str(int(k))) if k >= 0 else "" for k in arrays[k]]
                words = [f"{called[k]}: {word}" if word in twice else word for word in words]
                arrays[k] = np.array([numbers.setdefault(word, len(numbers)) if word else -1 for word in words])
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
        own={name: own_values(name) for name in own},
    )


def _names_of_several(meshes: Sequence[MeshFile], array: str) -> set[str]:
    """The names in an array that several files have."""
    count = Counter(name for mesh in meshes for name in set(mesh.names[array].values()) if name)
    return {name for name, times in count.items() if times > 1}
