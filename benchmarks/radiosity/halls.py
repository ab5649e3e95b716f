"""Halls of identical desks, whose lines all desks share, by hierarchical multipath: against flat solutions of small
ones, and one of a thousand desks."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer

from etendue.core import Array
from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    HierarchicalSolution,
    Part,
    PartProblem,
    Patches,
    RayScene,
    box,
    joined,
    shot_at_patches,
    solve,
)
from etendue.scene.builtin.theses.blocks import GAP
from etendue.scene.meshes import Mesh

from ..measuring import Record, verdict
from ..options import Out
from .options import OUT

#: Metres between desks, and height of the hall.
_PITCH, _HEIGHT = 2.2, 3.0
#: Bars of the issue: agreement, seconds on two cores, bytes.
_AGREES, _SECONDS, _BYTES = 0.03, 120.0, 4e9
#: Desks of a flat block along each side, and from how far from the walls on desks of a large hall are inside.
_BLOCK, _INSIDE = 11, 5


def desk(cell: float) -> Patches:
    """Plate on four legs, drawers, a screen, and a chair, in patches of about ``cell``."""

    def block(low: tuple[float, ...], high: tuple[float, ...]) -> Mesh:
        return box(low, high, np.maximum(np.rint((np.array(high) - low) / cell), 1).astype(int))

    def legs(xs: tuple[float, float], ys: tuple[float, float], half: float, height: float) -> list[Mesh]:
        return [block((x - half, y - half, GAP), (x + half, y + half, height - GAP)) for x in xs for y in ys]

    return Patches(
        *joined(
            block((-0.7, -0.35, 0.71), (0.7, 0.35, 0.75)),
            *legs((-0.65, 0.65), (-0.3, 0.3), 0.03, 0.71),
            block((0.2, -0.2, 0.2), (0.55, 0.3, 0.71 - GAP)),
            block((-0.3, 0.1, 0.75 + GAP), (0.3, 0.13, 1.1)),
            block((-0.2, -0.75, 0.42), (0.2, -0.37, 0.45)),
            block((-0.2, -0.78, 0.45 + GAP), (0.2, -0.75, 0.9)),
            *legs((-0.17, 0.17), (-0.72, -0.42), 0.02, 0.42),
        ),
        reflectance=0.5,
    )


def hall(across: int, along: int, cell: float, wall: float = 0.5) -> Part:
    """A hall of so many desks, each turned by a right angle against its neighbours; a lamp above every other one."""
    sides = np.array([_PITCH * across, _PITCH * along, _HEIGHT])
    room = box((0, 0, 0), sides, np.maximum(np.rint(sides / wall), 1).astype(int), inward=True)
    lamps = [
        box((x - 0.15, y - 0.6, 2.8), (x + 0.15, y + 0.6, 2.85), (1, 4, 1))
        for x in _PITCH * np.arange(1, across, 2)
        for y in _PITCH * (np.arange(along) + 0.5)
    ]
    vertices, faces = joined(room, *lamps)
    below = (vertices[faces][:, :, 2] == 2.8).all(axis=1)
    places = []
    for i in range(across):
        for j in range(along):
            c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[(i + j) % 4]
            x, y = _PITCH * (i + 0.5), _PITCH * (j + 0.5)
            places.append([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    around = Patches(vertices, faces, reflectance=0.6, emission=np.where(below, 100.0, 0.0))
    return Part(around, [(Part(desk(cell), objects=12), np.array(places))])


def _solved(root: Part, lines: int, seed: int, shot: float = 1.0, **regions: int) -> HierarchicalSolution:
    method = HierarchicalMultipath(HierarchicalMultipathSettings(lines=lines, shot=shot, **regions))
    method.prepare(PartProblem(root), seed)
    return method.solution(method.step(0, seed, method.start()).measurement)


def _flat(patches: Patches, bundles: int, seed: int) -> Array:
    shot = shot_at_patches(RayScene(patches), 1 << 23, OwenSobol(4, seed=50 + seed))
    segments = ABuffer(patches, OwenSobol(4, seed=seed)).cast(bundles)
    return solve(patches, segments, "conjugate-gradient", shot=shot).irradiance


def against_flat(
    lines: Annotated[int, typer.Option(min=1, help="N of a half.")] = 1 << 20,
    bundles: Annotated[int, typer.Option(min=1, help="Of half of the flat solution.")] = 1024,
    out: Out = OUT,
) -> Record:
    """A hall of 20 desks: the root mean square of the difference of irradiances, without noise."""
    root = hall(5, 4, 0.1)
    flat = root.joined()
    exact = [_flat(flat, bundles, seed) for seed in (1, 2)]
    areas = flat.areas[:, None]
    record = Record(
        f"A hall of 20 desks, {root.total} patches, against the flat solution",
        ("places, sectors, rings", "rms", "of the hall", "of desks", "mean", "noise of a half", "bar"),
    )
    for grid, sectors, rings in ((4, 4, 2), (8, 4, 2), (8, 8, 4)):
        regions = {"grid": grid, "sectors": sectors, "rings": rings}
        halves = [_solved(root, lines, seed, **regions) for seed in (1, 2)]
        found = [half.irradiance_on(flat)[0] for half in halves]
        off = [one - other for one, other in zip(found, exact, strict=True)]
        numbers = halves[0].tree.numbers_in_joined
        cells = []
        for rows in (numbers, numbers[: len(root)], numbers[len(root) :]):
            square = (areas * off[0] * off[1])[rows].sum() / (areas * exact[0] * exact[1])[rows].sum()
            cells.append(np.sign(square) * np.sqrt(abs(square)))
        mean = (areas * (off[0] + off[1])).sum() / 2 / (areas * exact[0]).sum()
        noise = np.sqrt((areas * (found[0] - found[1]) ** 2).sum() / 2 / (areas * exact[0] * exact[1]).sum())
        shown = [f"{value:.2%}" for value in cells]
        bar = verdict(cells[0], _AGREES) if grid == 4 else ""
        record.add(f"{grid}x{grid}, {sectors}, {rings}", *shown, f"{mean:+.2%}", f"{noise:.2%}", bar)
    record.notes.append("of irradiances, weighted by area; the product of the differences of two independent halves")
    return record


def thousand(
    cell: Annotated[float, typer.Option(min=0.001, help="Metres of a patch of a desk.")] = 0.024,
    lines: Annotated[int, typer.Option(min=1, help="N.")] = 3 << 20,
    out: Out = OUT,
) -> Record:
    """A hall of 40 x 25 desks in one pass: CPU seconds and memory."""
    _solved(hall(2, 2, 0.3), 1 << 15, 1)  # compiles
    root = hall(40, 25, cell)
    begin = time.process_time()
    found = _solved(root, lines, 1)
    seconds = time.process_time() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    sent = found.sent[0]
    off = (sent - found.absorbed - found.to_sky - found.lost - found.residual)[0] / sent
    record = Record(f"A hall of 1000 desks, {root.total} patches, {len(root.distinct[0])} of a desk", ("", "", "bar"))
    record.add("CPU seconds, both cores", f"{seconds:.0f}", "")
    record.add("the same by two cores, at best", f"{seconds / 2:.0f}", verdict(seconds / 2, _SECONDS))
    record.add("peak memory", f"{peak / 1e9:.2f} GB", verdict(peak, _BYTES))
    record.add("power that is not accounted for", f"{abs(off):.1g}", verdict(abs(off), 1e-6))
    record.add("power on its way", f"{found.residual[0] / sent:.1g}", "")
    return record


def inside(
    cell: Annotated[float, typer.Option(min=0.001, help="Metres of a patch of a desk.")] = 0.1,
    lines: Annotated[int, typer.Option(min=1, help="N.")] = 3 << 20,
    bundles: Annotated[int, typer.Option(min=1, help="Of half of the flat solutions.")] = 512,
    out: Out = OUT,
) -> Iterator[Record]:
    """Desks inside the hall of 40 x 25 against the desk in the middle of flat blocks."""
    root = hall(40, 25, cell)
    found = _solved(root, lines, 1, shot=2.0)
    record = Record(
        f"Desks inside a hall of 1000, {root.total} patches, against the middle of flat blocks",
        ("flat block", "patches", "mean of a desk", "rms over its patches", "bar"),
    )
    for size in (_BLOCK - 4, _BLOCK):
        block = hall(size, size, cell)
        middle = (size // 2) * size + size // 2
        flat = block.joined()
        # Node by node: the hall around, then desk by desk.
        rows = slice(len(block) + middle * (n := len(block.distinct[0])), len(block) + (middle + 1) * n)
        halves = [_flat(flat, bundles, seed)[rows] for seed in (1, 2)]
        expected, areas = np.mean(halves, axis=0), block.distinct[0].patches.areas[:, None]  # type: ignore[union-attr]
        alike = [
            25 * i + j
            for i in range(_INSIDE, 40 - _INSIDE)
            for j in range(_INSIDE, 25 - _INSIDE)
            if (i - size // 2) % 2 == 0 and (i + j - 2 * (size // 2)) % 4 == 0
        ]
        mean = np.mean([found.irradiance(1 + k) for k in alike], axis=0)
        off = (areas * (mean - expected)).sum() / (areas * expected).sum()
        square = (areas * (mean - halves[0]) * (mean - halves[1])).sum() / (areas * expected**2).sum()
        rms = np.sign(square) * np.sqrt(abs(square))
        bar = verdict(abs(off), _AGREES) if size == _BLOCK else ""
        record.add(f"{size} x {size}", str(len(flat)), f"{off:+.2%}", f"{rms:.2%}", bar)
    record.notes.append(
        f"mean of {len(alike)} desks of the same turn, {_INSIDE} or more from the walls; those of a block are nearer. "
        "The noise of the flat solutions is taken off by two halves"
    )
    yield record
