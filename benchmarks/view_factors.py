"""View factors of a room with boxes by lines, by integrals and by other programs: CPU time, and what comes of them.

Each program computes all view factors F in a process of its own, and from them F J for a given smooth radiosity J, and
the radiosities of a room that reflects 0.7 and has a small lamp. Errors are relative for each patch, root mean square.

pyViewFactor is asked for with ``--peer-python``, a Python that has it (``pip install pyviewfactor==1.1.0`` in an
environment of its own); View3D with ``--view3d``: see :mod:`peer_view3d`.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from etendue.radiosity import ABuffer, Patches, SpiralPoints, solve

from . import peer_view3d
from .exchanges import room, smooth_radiosity
from .measuring import Record, child, verdict
from .options import Bundles, Cells

#: Share of the CPU time and of the error of pyViewFactor; the error of F J in rooms of these numbers of cells, and
#: those where time counts with the solution.
_TIME_BAR, _ERROR_BAR = 1 / 20, 1 / 6
#: Share of the CPU time of View3D by integrals to 1e-3, in rooms of these numbers of cells.
_EXACT_BARS = {24: 1 / 10}
_ERROR_BARS, _WHOLE_BARS = {20: 1.5e-3, 24: 2e-3}, (24,)
#: Runs and bundles of the reference by lines; their seeds are not that of the run that is measured.
_RUNS, _BUNDLES, _FIRST_SEED = 16, 2048, 1000
_PEER = Path(__file__).with_name("peer_pyviewfactor.py")


@dataclass(frozen=True)
class Outcome:
    """CPU seconds of the first call (loading or compiling), of all view factors, of a solution; F J and irradiance."""

    first: float | None
    factors: float
    solution: float
    gathered: np.ndarray
    irradiance: np.ndarray


def measure(
    sizes: Cells = "10,20,24",
    bundles: Bundles = 1024,
    lines: Annotated[float, typer.Option(min=1, help="Lines of a bundle.")] = 48000,
    tolerance: Annotated[float, typer.Option(help="Of rows by integrals.")] = 1e-3,
    peer_python: Annotated[
        str | None, typer.Option(help="A Python that has pyViewFactor 1.1.0.", metavar="PROGRAM")
    ] = None,
    view3d: peer_view3d.Program = None,
) -> Record:
    """Every program on rooms of these numbers of cells."""
    columns = ("", "patches", "first call s", "factors CPU s", "F J error", "worst", "solution CPU s", "error", "whole")
    record = Record("View factors of a room with boxes", columns)
    for cells in sizes:
        patches = room(cells)
        outcomes = {
            "lines": _ours(cells, bundles, lines),
            "lines, cold": _ours(cells, bundles, lines, cold=True),
            "integrals": _ours(cells, bundles, lines, tolerance=tolerance),
        }
        others = {"pyViewFactor": _pyviewfactor(patches, peer_python), "View3D": _view3d(patches, view3d)}
        outcomes |= {name: outcome for name, outcome in others.items() if outcome is not None}
        exact, note = _reference(patches, lines, outcomes.get("View3D"))
        record.notes.append(f"{len(patches)} patches: {note}")
        errors = {}
        for name, outcome in outcomes.items():
            if outcome is None:
                record.add(name, str(len(patches)), *["failed"] * 7)
                continue
            off = np.abs(outcome.gathered / exact[0] - 1)
            solved = float(np.sqrt(np.mean((outcome.irradiance / exact[1] - 1) ** 2)))
            errors[name] = float(np.sqrt(np.mean(off**2)))
            record.add(
                *(name, str(len(patches)), "" if outcome.first is None else f"{outcome.first:.2f}"),
                *(f"{outcome.factors:.2f}", f"{errors[name]:.2g}", f"{off.max():.2g}"),
                *(f"{outcome.solution:.2f}", f"{solved:.2g}", f"{outcome.factors + outcome.solution:.2f}"),
            )
        ours, theirs = outcomes["integrals"], outcomes.get("View3D")
        if ours is not None and theirs is not None:
            ratio = ours.factors / theirs.factors
            record.notes.append(
                f"{len(patches)} patches, integrals to View3D: CPU time {ratio:.3f}"
                + f", {verdict(ratio, _EXACT_BARS.get(cells))}".removesuffix(", ")
            )
        ours, theirs = outcomes["lines"], outcomes.get("pyViewFactor")
        if ours is not None and theirs is not None:
            record.notes.append(_verdicts(cells, ours, theirs, errors["lines"], errors["pyViewFactor"]))
    record.notes += [
        "CPU s: of all threads; first call: on a room of 136 patches, loads what is compiled (cold: compiles)",
        f"lines: {bundles} bundles of {lines:g} lines; integrals: rows to {tolerance:g}; in a process of their own",
    ]
    if not peer_python:
        record.notes.append(
            "pyViewFactor: --peer-python was not given; how to install it stands in benchmarks/view_factors.py"
        )
    if not view3d:
        record.notes.append(peer_view3d.HOW)
    return record


def _verdicts(cells: int, ours: Outcome, theirs: Outcome, our_error: float, their_error: float) -> str:
    time, whole = ours.factors / theirs.factors, (ours.factors + ours.solution) / (theirs.factors + theirs.solution)
    parts = [
        f"room({cells}), lines to pyViewFactor: CPU time {time:.3f}, {verdict(time, _TIME_BAR)}",
        f"with a solution {whole:.3f}, {verdict(whole, _TIME_BAR if cells in _WHOLE_BARS else None)}",
        f"F J error {our_error:.2g}, {verdict(our_error, _ERROR_BARS.get(cells))}",
        f"{our_error / their_error:.2f} of its, {verdict(our_error / their_error, round(_ERROR_BAR, 3))}",
    ]
    return "; ".join(part.removesuffix(", ") for part in parts)


def _ours(cells: int, bundles: int, lines: float, cold: bool = False, tolerance: float | None = None) -> Outcome | None:
    """By ``benchmarks.child``: by lines, or by integrals to a ``tolerance``; ``cold`` with an empty folder for compiled
    loops."""
    with tempfile.TemporaryDirectory(prefix="loops-") as folder:
        out = Path(folder) / "out.npz"
        options = {"cells": cells, "bundles": bundles, "lines": lines, "tolerance": tolerance, "out": str(out)}
        seconds = child("view-factors", options, {"NUMBA_CACHE_DIR": folder} if cold else None)
        return _read(out, seconds) if seconds else None


def _pyviewfactor(patches: Patches, python: str | None) -> Outcome | None:
    if not python:
        return None
    with tempfile.TemporaryDirectory(prefix="peer-") as folder:
        given, out = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(
            given,
            vertices=patches.vertices,
            faces=patches.faces,
            walls=(patches.centres == 0).any(axis=1) | (patches.centres == 1).any(axis=1),
            radiosity=smooth_radiosity(patches.centres),
            reflectance=patches.reflectance[:, 0],
            emission=patches.emission[:, 0],
        )
        run = subprocess.run([python, str(_PEER), str(given), str(out)], check=True, capture_output=True, text=True)
        return _read(out, json.loads(run.stdout.strip().splitlines()[-1]))


def _view3d(patches: Patches, program: str | None) -> Outcome | None:
    if not program:
        return None
    with tempfile.TemporaryDirectory(prefix="view3d-") as folder:
        given = Path(folder) / "room.vs3"
        text = ["T room with boxes", "C encl=1 list=0 eps=1.0e-4", "F 3"]
        text += [f"V {i} {x:.12g} {y:.12g} {z:.12g}" for i, (x, y, z) in enumerate(patches.vertices, 1)]
        text += [f"S {i} {a} {b} {c} {d} 0 0 0.9 s{i}" for i, (a, b, c, d) in enumerate(patches.faces + 1, 1)]
        given.write_text("\n".join([*text, "End of data", ""]))
        seconds, matrix = peer_view3d.run(program, given)
    # Its text has six decimals, which is as much as its entries are worth; rows are closed again.
    matrix /= matrix.sum(axis=1, keepdims=True)
    return Outcome(None, seconds, 0.0, matrix @ smooth_radiosity(patches.centres), _solved(patches, matrix))


def _solved(patches: Patches, matrix: np.ndarray) -> np.ndarray:
    reflectance, emission = patches.reflectance[:, 0], patches.emission[:, 0]
    return matrix @ np.linalg.solve(np.eye(len(patches)) - reflectance[:, None] * matrix, emission)


def _read(out: Path, seconds: dict[str, float]) -> Outcome:
    with np.load(out) as arrays:
        return Outcome(**seconds, gathered=arrays["gathered"], irradiance=arrays["irradiance"])


def _reference(patches: Patches, lines: float, view3d: Outcome | None) -> tuple[tuple[np.ndarray, np.ndarray], str]:
    """F J and the irradiance of the room, and where they are from: many lines of other seeds."""
    gathered, irradiance = [], []
    for run in range(_RUNS):
        segments = ABuffer(patches, SpiralPoints(_FIRST_SEED + run, _BUNDLES), lines).cast(_BUNDLES)
        gathered.append(segments.gather(smooth_radiosity(patches.centres)))
        irradiance.append(solve(patches, segments, "conjugate-gradient", tolerance=1e-6).irradiance[:, 0])
    means, parts = [], []
    for values in (np.array(gathered), np.array(irradiance)):
        means.append(values.mean(axis=0))
        spread = values.std(axis=0, ddof=1) / np.sqrt(_RUNS) / means[-1]
        parts.append(f"{np.sqrt(np.mean(spread**2)):.1g}")
    note = (
        f"reference: {_RUNS} runs of {_BUNDLES} bundles of {lines:g} lines, errors {parts[0]} and {parts[1]} by scatter"
    )
    if view3d is not None:
        off = [
            np.sqrt(np.mean((theirs / ours - 1) ** 2))
            for theirs, ours in zip((view3d.gathered, view3d.irradiance), means, strict=True)
        ]
        note += f"; View3D differs from it by {off[0]:.1g} and {off[1]:.1g}"
    return (means[0], means[1]), note
