"""Exact form factors of meshes: time and errors of integrals and of View3D, beside integrals to a fine tolerance.

An L-shaped room of eight patches, and files of View3D. Errors are root mean square over patches: of the sum of a row,
and of F J for a radiosity J that varies smoothly, in units of its mean.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.radiosity import Patches, exact_form_factors, read_patches

from . import peer_view3d
from .exchanges import smooth_radiosity
from .measuring import Clock, Record, rms, timed, verdict
from .options import words

#: Tolerances of integrals in files and in the L-shaped room, and by how much that of the reference is finer.
_TOLERANCES, _OF_ROOM, _FINER = (1e-3, 5e-4), 3e-6, 100
#: Seconds in the L-shaped room; CPU time to View3D's for an error that is not larger.
_ROOM_BAR, _BAR = 0.1, 1.0


def l_room() -> str:
    """A file of View3D: walls of an L, and a floor and a ceiling of two rectangles each, which are combined."""
    plan = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 1)]
    walls = [(1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 1)]
    lines = ["C encl=1 list=0 eps=1e-4", "F 3"]
    lines += [f"V {k + 7 * z} {x} {y} {z}" for z in (0, 1) for k, (x, y) in enumerate(plan, 1)]
    quads = [(a, a + 7, b + 7, b) for a, b in walls]
    quads += [(1, 2, 3, 7), (7, 4, 5, 6), (14, 10, 9, 8), (13, 12, 11, 14)]
    of = {8: 7, 10: 9}
    lines += [f"S {k} {' '.join(map(str, quad))} 0 {of.get(k, 0)} 0.9 s{k}" for k, quad in enumerate(quads, 1)]
    return "\n".join([*lines, "E", ""])


def measure(
    meshes: Annotated[Any, typer.Option(parser=words, help="Files of View3D (.vs3).", metavar="FILE,...")] = "",
    rounds: Annotated[int, typer.Option(min=1, help="Runs of each; the median counts.")] = 3,
    view3d: peer_view3d.Program = None,
) -> Record:
    """The L-shaped room, and ``meshes``."""
    record = Record("Exact form factors", ("", "patches", "program", "CPU s", "s", "row error", "F J error"))
    with tempfile.TemporaryDirectory(prefix="l-room-") as folder:
        room = Path(folder) / "l-room.vs3"
        room.write_text(l_room())
        _add(record, room, (_OF_ROOM,), rounds, view3d)
        record.notes.append(
            f"l-room, {record.rows[0][2]}: {record.rows[0][4]} s, {verdict(float(record.rows[0][4]), _ROOM_BAR)}"
        )
        for mesh in meshes:
            _add(record, Path(mesh), _TOLERANCES, rounds, view3d)
    if not view3d:
        record.notes.append(peer_view3d.HOW)
    return record


def _add(record: Record, path: Path, tolerances: tuple[float, ...], rounds: int, view3d: str | None) -> None:
    """Rows of a file, and how integrals compare with View3D."""
    patches = read_patches(path)
    fine = exact_form_factors(patches, min(tolerances) / _FINER).matrix.toarray()
    clocks: defaultdict[str, list[Clock]] = defaultdict(list)
    matrices: dict[str, Array] = {}

    def integrate(name: str, tolerance: float) -> None:
        matrices[name] = exact_form_factors(patches, tolerance).matrix.toarray()

    for _ in range(rounds):
        for tolerance in tolerances:
            name = f"integrals to {tolerance:g}"
            clocks[name].append(timed(integrate, name, tolerance))
        if view3d:
            seconds, matrices["View3D"] = peer_view3d.run(view3d, path)
            clocks["View3D"].append(Clock(seconds, seconds))
    radiosity, found = _radiosity(patches), {}
    for name, matrix in matrices.items():
        cpu, wall = median(clock.cpu for clock in clocks[name]), median(clock.wall for clock in clocks[name])
        off = matrix - fine
        error = rms(off.sum(axis=1))
        found[name] = cpu, error
        errors = f"{error:.2g}", f"{rms(off @ radiosity) / radiosity.mean():.2g}"
        record.add(path.stem, str(len(patches)), name, f"{cpu:.3f}", f"{wall:.3f}", *errors)
    if view3d:
        cpu, error = found.pop("View3D")
        for name, ours in found.items():
            ratio = ours[0] / cpu
            bar = verdict(ratio, _BAR if ours[1] <= error and len(tolerances) > 1 else None)
            told = f"{path.stem}, {name} to View3D: CPU time {ratio:.2f}, error {ours[1] / error:.2g}"
            record.notes.append(f"{told}, {bar}".removesuffix(", "))


def _radiosity(patches: Patches) -> Array:
    """That of rooms, over the box of the mesh."""
    centres = patches.centres - patches.centres.min(axis=0)
    return smooth_radiosity(centres / np.ptp(patches.centres, axis=0).max())
