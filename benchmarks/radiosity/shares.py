"""How hierarchical multipath should share out its lines between the whole scene and its parts: fixed shares, areas, and
the mutual information of each part, the future work of the thesis."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Annotated

import numpy as np
import typer

from etendue.core import Array, seed_key
from etendue.points import OwenSobol
from etendue.radiosity import HierarchicalMultipath, Part
from etendue.radiosity.lines.generators import box_lines

from ..measuring import Record
from ..options import Out, Seeds
from .boxes import BOTH, Room, Rooms, _quotient
from .options import OUT
from .references import mean_squared_error

#: Lines of a pilot, and lines at once in it.
_PILOT, _AT_ONCE = 1 << 12, 16
#: N of a pass of the reference, in those of the runs, and its passes.
_REFERENCE, _PASSES = 4, 12
#: Shares of the top level that are tried, of 0.9 N.
_TOP = (0.25, 0.4, 0.55, 0.85)
#: The shares of the thesis, in N.
_FIXED, _WHOLE = 0.65, 0.9


class Information:
    r"""Mutual information of what a part holds, its own patches and the boxes of its copies and around it,

    .. math:: I = \int \int \frac{F(x, y)}{A} \log_2 (A F(x, y)) \, dx \, dy, \quad F = \cos \cos / (\pi r^2)

    with the total area A (Feixas and others, 1999), in bits, from ``count`` lines. Stretches of lines of uniform
    density have the density F / A, so I is the mean of their logarithms: without bias for any number of lines, which
    estimates from the counts of pairs of patches do not have. ``error``: standard error from the scatter of lines.
    ``area``: A, of what lines see.
    """

    def __init__(self, part: Part, is_root: bool, seed: int, count: int = _PILOT) -> None:
        self._part, self._is_root = part, is_root
        patches = part.patches
        faces = np.zeros((0, 4, 3)) if patches is None else patches.vertices[patches.faces]
        self._corners, self._normals = faces, np.zeros((0, 3)) if patches is None else patches.face_normals
        self._middle = faces.mean(axis=1)
        self._reach = np.linalg.norm(faces - self._middle[:, None], axis=2).max(axis=1, initial=0)
        origins, ways = box_lines(OwenSobol(4, seed=seed_key(seed, "pilot", 0)[0]).block(count), *part.bounds)
        size = float(np.linalg.norm(part.bounds[1] - part.bounds[0]))
        logs, stretches = np.zeros(count), np.zeros(count)
        for begin in range(0, count, _AT_ONCE):
            here = slice(begin, begin + _AT_ONCE)
            line, start, end, distance = self._stretches(origins[here], ways[here], 1e-9 * size)
            np.add.at(logs, begin + line, np.log2(start * end / (np.pi * distance**2)))
            np.add.at(stretches, begin + line, 1.0)
        mean = stretches.mean()
        self.area = part.box_area * mean
        self.bits = float(logs.mean() / mean + np.log2(self.area))
        off = logs - (self.bits - np.log2(self.area)) * stretches  # of a quotient of means
        self.error = float(off.std() / mean / np.sqrt(count))

    def _stretches(self, origins: Array, ways: Array, least: float) -> tuple[Array, Array, Array, Array]:
        """Line, cosines at both ends and length of each free stretch of lines (k, 3)."""
        line, at, cosine = self._hits(origins, ways)
        for child, matrix in self._part.children:
            assert (matrix == np.eye(4)).all(), "groups have the coordinates of the scene"
            found, near, far, near_cosine, far_cosine = _through(*child.bounds, origins, ways)
            line, at = np.concatenate([line, found, found]), np.concatenate([at, near, far])
            cosine = np.concatenate([cosine, -near_cosine, far_cosine])
        if not self._is_root:
            found, near, far, near_cosine, far_cosine = _through(*self._part.bounds, origins, ways)
            line, at = np.concatenate([line, found, found]), np.concatenate([at, near, far])
            cosine = np.concatenate([cosine, near_cosine, -far_cosine])
        order = np.lexsort((at, line))
        line, at, cosine = line[order], at[order], cosine[order]
        free = (line[1:] == line[:-1]) & (cosine[:-1] > 0) & (cosine[1:] < 0) & (np.diff(at) > least)
        k = np.flatnonzero(free)
        return line[k], cosine[k], -cosine[k + 1], at[k + 1] - at[k]

    def _hits(self, origins: Array, ways: Array) -> tuple[Array, Array, Array]:
        """Lines, distances and cosines of all hits of faces."""
        slant = ways @ self._normals.T
        along = (self._normals * self._middle).sum(axis=1) - origins @ self._normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = np.where(np.abs(slant) > 1e-12, along / slant, np.inf)
        square = np.full(at.shape, np.inf)
        known = np.isfinite(at)
        off = self._middle[None] - origins[:, None]
        along_way = (off * ways[:, None]).sum(axis=2)
        square[known] = ((off**2).sum(axis=2) - along_way**2 + (at - along_way) ** 2)[known]
        line, face = np.nonzero(square <= self._reach**2 * (1 + 1e-9))
        points = origins[line] + at[line, face][:, None] * ways[line]
        corners, inside = self._corners[face], np.ones(len(face), dtype=bool)
        for k in range(4):
            edge = corners[:, (k + 1) % 4] - corners[:, k]
            turn = np.cross(edge, points - corners[:, k])
            inside &= (turn * self._normals[face]).sum(axis=1) >= 0
        line, face = line[inside], face[inside]
        return line, at[line, face], slant[line, face]


def _through(low: Array, high: Array, origins: Array, ways: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Lines through a box: their numbers, where they enter and leave, and cosines to its sides there."""
    with np.errstate(divide="ignore"):
        ends = np.sort((np.stack([low, high])[:, None] - origins) / ways, axis=0)
    first, last = ends[0].argmax(axis=1), ends[1].argmin(axis=1)
    near, far = ends[0].max(axis=1), ends[1].min(axis=1)
    k = np.flatnonzero(near < far)
    return k, near[k], far[k], np.abs(ways[k, first[k]]), np.abs(ways[k, last[k]])


#: Weights of the parts of a scene, the whole scene last.
Weights = Callable[[Mapping[Part, Information]], Mapping[Part, float]]
RULES: dict[str, Weights] = {
    "information": lambda known: {part: of.bits for part, of in known.items()},
    "area": lambda known: {part: of.area for part, of in known.items()},
    "information times area": lambda known: {part: of.bits * of.area for part, of in known.items()},
}


def measure(
    scenes: Rooms = BOTH,
    lines: Annotated[int, typer.Option(min=1, help="N.")] = 1 << 16,
    seeds: Seeds = 10,
    out: Out = OUT,
) -> Iterator[Record]:
    """Two tables of each scene: the mutual information of its parts, and the errors of multipath by shares."""
    for name in scenes:
        yield from _measure(Room.of(name), lines, seeds)


def _measure(room: Room, lines: int, seeds: int) -> Iterator[Record]:
    parts = room.boxed.distinct
    pilots = [{part: Information(part, part is room.boxed, seed) for part in parts} for seed in range(seeds)]
    yield _pilots(room, pilots)

    def method(seed: int) -> HierarchicalMultipath:
        return room.method(True, lines, seed=seed)

    base = method(1).lines
    inside = {part: base[part] / sum(base[p] for p in parts if p is not room.boxed) for part in parts}

    def fixed(top: float) -> dict[Part, float]:
        return {part: top if part is room.boxed else (1 - top) * inside[part] for part in parts}

    ways = {f"whole scene {_FIXED:.0%}, parts 25 % by objects (thesis)": [fixed(_FIXED / _WHOLE)] * seeds}
    ways |= {f"by {name}": [dict(rule(pilot)) for pilot in pilots] for name, rule in RULES.items()}
    ways |= {f"whole scene {top * _WHOLE:.0%}, parts by objects": [fixed(top)] * seeds for top in _TOP}
    exact = room.solved(room.method(True, _REFERENCE * lines, seed=9000), _PASSES)
    errors = {name: np.empty((seeds, 1)) for name in ways}
    for seed in range(seeds):
        for name, shares in ways.items():
            made, total = method(seed + 1), sum(shares[seed].values())
            made.lines = {part: max(round(_WHOLE * lines * shares[seed][part] / total), 1) for part in parts}
            errors[name][seed, 0] = mean_squared_error(room.patches, room.solved(made), exact)
    first = next(iter(ways))
    record = Record(
        f"Shares of lines, {room.title}, N = {lines}, {seeds} seeds", ("shares", "whole scene", "MSE", "to the first")
    )
    for name, shares in ways.items():
        top = np.mean([share[room.boxed] / sum(share.values()) for share in shares])
        ratio = "1" if name == first else _quotient(errors[name], errors[first])
        record.add(name, f"{top * _WHOLE:.0%}", f"{errors[name].mean():.4g}", ratio)
    record.notes.append(
        f"{_WHOLE} N lines in all and N rays of a first shot; from the method's own solution by {_PASSES} passes of "
        f"N = {_REFERENCE * lines} by the shares of the first row"
    )
    yield record


def _pilots(room: Room, pilots: list[dict[Part, Information]]) -> Record:
    record = Record(
        f"Mutual information, {room.title}, pilots of {_PILOT} lines, {len(pilots)} seeds",
        ("part", "patches", "bits", "scatter of a pilot", "its standard error", "area", "of the box"),
    )
    for k, part in enumerate(pilots[0]):
        known = [pilot[part] for pilot in pilots]
        bits = np.array([one.bits for one in known])
        record.add(
            "whole scene" if part is room.boxed else f"part {k + 1}, {part.objects} objects",
            *(f"{len(part)}", f"{bits.mean():.3f}", f"{bits.std(ddof=1):.3f}"),
            *(f"{np.mean([one.error for one in known]):.3f}", f"{known[0].area:.1f}", f"{part.box_area:.1f}"),
        )
    return record
