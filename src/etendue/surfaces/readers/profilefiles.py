"""Profiles of surfaces of revolution, a ring in each row of a table."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from etendue.core import suggest

from ..errors import PatchError
from ..revolution import checked_profile, revolved
from .surfacefiles import MeshFile

_ENDS = ("r1", "z1", "r2", "z2")
_KNOWN = ("name", *_ENDS, "emissivity", "temperature")


def read_profile(path: Path) -> MeshFile:
    """The rings, with ``emissivity`` and ``temperature`` if there are such columns; rings of one name are a group.

    Raises :class:`PatchError` for unknown and missing columns, words in place of numbers, and what
    :func:`checked_profile` refuses.
    """
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        lines = [(number, line) for number, line in enumerate(file, 1) if line.strip() and line.strip()[0] != "#"]
    table = [[cell.strip() for cell in row] for row in csv.reader(line for _, line in lines)]
    columns = [cell.lower() for cell in table[0]] if table else []
    if missing := [name for name in _ENDS if name not in columns]:
        raise PatchError(
            f"{path} is no profile of surfaces of revolution: it has no column '{missing[0]}' (columns are "
            f"{', '.join(_KNOWN)})"
        )
    for name in columns:
        if name not in _KNOWN:
            raise PatchError(f"{path} has an unknown column '{name}'; {suggest(name, _KNOWN)}")
        if columns.count(name) > 1:
            raise PatchError(f"{path} has the column '{name}' twice")
    if len(table) == 1:
        raise PatchError(f"{path} has no rings")
    numbers = [name for name in columns if name != "name"]
    values, names = np.empty((len(table) - 1, len(numbers))), []
    for k, row in enumerate(table[1:]):
        where = f"{path}, line {lines[k + 1][0]}"
        if len(row) != len(columns):
            raise PatchError(f"{where}: there are {len(row)} cells for {len(columns)} columns")
        cells = dict(zip(columns, row, strict=True))
        names.append(cells.get("name") or str(k + 1))
        for place, name in enumerate(numbers):
            try:
                values[k, place] = float(cells[name])
            except ValueError:
                raise PatchError(f"{where}: {name} is a number, not '{cells[name]}'") from None
    arrays = dict(zip(numbers, values.T, strict=True))
    places = [f"{path}, line {number}: '{name}'" for name, (number, _) in zip(names, lines[1:], strict=True)]
    profile = checked_profile(np.stack([arrays.pop(name) for name in _ENDS], axis=1), places)
    emissivity = arrays.get("emissivity", np.ones(len(profile)))
    if len(bad := np.flatnonzero(~((emissivity >= 0) & (emissivity <= 1)))):
        raise PatchError(f"{places[bad[0]]} has the emissivity {emissivity[bad[0]]:g}, which is not in [0, 1]")
    known = {name: k for k, name in enumerate(dict.fromkeys(names))}
    vertices, faces, rows = revolved(profile)
    return MeshFile(
        points=vertices,
        faces=faces,
        rows=rows,
        cells={"name": np.array([known[name] for name in names]), **arrays},
        names={"name": {k: name for name, k in known.items()}},
        own={"reflectance": 1 - emissivity} if "emissivity" in arrays else {},
        profile=profile,
    )
