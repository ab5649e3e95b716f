"""Hierarchical multipath against the flat one (chapter 5 of the thesis): tests that casting takes, the bias of boxes,
and what sequences gain."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array, seed_key
from etendue.display import false_colour, write_png
from etendue.points import OwenSobol, PointSet
from etendue.radiosity import (
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    Part,
    PartProblem,
    Patches,
    RayScene,
    grouped,
)
from etendue.radiosity.hierarchical_multipath.lists import PartRays
from etendue.radiosity.hierarchical_multipath.parts import Tree
from etendue.radiosity.lines.generators import box_lines

from ..measuring import Record, verdict
from ..options import Out, Seeds, named, whole_numbers
from .drivers import DRIVERS, INDEPENDENT
from .options import OUT
from .plain_caster import PlainCaster
from .references import mean_squared_error
from .scenes import FURNISHED, LEAST
from .sweeping import half_and_half

Rooms = Annotated[
    Any, typer.Option("--scene", parser=named(FURNISHED, "scene"), help="Names, by commas.", metavar="NAMES")
]
Counts = Annotated[Any, typer.Option("--lines", parser=whole_numbers, help="N, by commas.", metavar="N,...")]
BOTH = "room,office"
#: Bars of the issue.
_TOP, _SHOT = 0.3, 0.65
#: N of a pass of a reference, and passes of its halves.
_REFERENCE, _PASSES = 1 << 18, 6


@dataclass(frozen=True)
class Room:
    """A furnished room with and without boxes."""

    name: str
    patches: Patches
    boxed: Part
    flat: Part

    @classmethod
    def of(cls, name: str) -> Room:
        """By its name."""
        patches, objects = FURNISHED[name](1.0)
        return cls(name, patches, grouped(patches, objects, least=LEAST), Part(patches))

    @property
    def title(self) -> str:
        """For tables."""
        boxes = ", ".join(f"{len(part)} in {part.objects} objects" for part, _ in self.boxed.children)
        return f"{self.name}, {len(self.patches)} patches, in boxes {boxes}"

    def method(self, is_boxed: bool, lines: int, driver: str = "", seed: int = 0, **more: Any) -> HierarchicalMultipath:
        """Prepared; flat multipath is that of a hierarchy without boxes, with N lines."""

        def points(purpose: str, number: int) -> PointSet:
            key = seed_key(number, purpose, 0)[0]
            return DRIVERS[driver](lines, key % (1 << 31)) if driver else OwenSobol(4, seed=key)

        shares = {} if is_boxed else {"top": 1.0}
        made = HierarchicalMultipath(HierarchicalMultipathSettings(lines=lines, **{**shares, **more}), points)
        made.prepare(PartProblem(self.boxed if is_boxed else self.flat), seed)
        return made

    def solved(self, method: HierarchicalMultipath, passes: int = 1, first: int = 0) -> Array:
        """Radiosity by so many passes."""
        seed = method._seed
        total = method.step(first, seed, {}).measurement
        for k in range(first + 1, first + passes):
            total += method.step(k, seed, {}).measurement
        return method.solution(total).on(self.patches).radiosity

    def references(self, lines: int = 0) -> dict[bool, tuple[Array, Array]]:
        """Of the method with and without boxes its own converged radiosity [Castro 2002, sec. 5.4], in two halves of
        four times the ``lines`` or more."""
        found, passes = {}, max(_PASSES, 4 * lines // _REFERENCE)
        for is_boxed in (True, False):
            halves = [self.solved(self.method(is_boxed, _REFERENCE, seed=9000 + half), passes) for half in range(2)]
            found[is_boxed] = halves[0], halves[1]
        return found


def tests(
    scenes: Rooms = BOTH,
    lines: Annotated[int, typer.Option(min=1, help="Rays and lines whose tests are counted.")] = 1 << 14,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene: ray-polygon tests of casting (figures 5.5 and 5.6 of the thesis), and seconds beside."""
    for name in scenes:
        yield _tests(Room.of(name), lines)


def _tests(room: Room, count: int) -> Record:
    method = room.method(True, 16 * count)
    lists = method.cast_lines()
    every = grouped(room.patches, FURNISHED[room.name](1.0)[1], 1e9, least=1)
    casters = {
        "flat": PlainCaster(Tree(room.flat), {p: PartRays(p) for p in room.flat.distinct}),
        "objects": PlainCaster(Tree(every), {p: PartRays(p) for p in every.distinct}),
        "boxed": PlainCaster(Tree(room.boxed), method._rays, lists),
    }
    u = OwenSobol(4, seed=5).block(count)
    o, d = box_lines(u, *room.flat.bounds)
    rays = _from_lamp(room.patches, OwenSobol(4, seed=6).block(count))
    options = method._options
    top = options.top * casters["boxed"].line_tests(o, d, "top")
    plain = {name: casters["flat" if name == "all" else "objects"].line_tests(o, d, name) for name in ("all", "boxes")}
    shots = {
        "every polygon": casters["flat"].first_hits(*rays, "all"),
        "a box for each object": casters["objects"].first_hits(*rays, "boxes"),
        "boxes of the hierarchy": casters["boxed"].first_hits(*rays, "boxes"),
        "conservative lists": casters["boxed"].first_hits(*rays, "conservative"),
        "lists of the thesis": casters["boxed"].first_hits(*rays, "listed"),
    }
    exact = shots["boxes of the hierarchy"].hits
    record = Record(f"Tests of casting, {room.title}", ("", "tests a line", "to every polygon", "wrong hits", "bar"))
    for name, value in plain.items():
        which = "every polygon" if name == "all" else "a box for each object"
        record.add(f"lines, flat, {which}", f"{value / count:.0f}", f"{value / plain['all']:.3f}", "", "")
    record.add(
        *("lines of the top level, 0.65 N", f"{top / count:.0f}", f"{top / plain['all']:.3f}", ""),
        verdict(top / plain["all"], _TOP),
    )
    for name, hits in shots.items():
        wrong = f"{(hits.hits != exact).any(axis=1).mean():.2%}" if name.endswith("thesis") else ""
        ratio = hits.tests / shots["every polygon"].tests
        bar = verdict(ratio, _SHOT) if name == "conservative lists" else ""
        record.add(f"first shot, {name}", f"{hits.tests / count:.0f}", f"{ratio:.3f}", wrong, bar)
    seconds = {name: _seconds(room, is_boxed, 8 * count) for name, is_boxed in (("flat", False), ("boxed", True))}
    ratio = seconds["boxed"][0] / seconds["flat"][0]
    record.notes += [
        f"top level to flat lines with a box for each object: {top / plain['boxes']:.2f}; first shot by conservative "
        f"lists to that: {shots['conservative lists'].tests / shots['a box for each object'].tests:.2f}",
        f"seconds of the top level by a tree of boxes (BVH), to those of flat lines: {ratio:.2f}; of these "
        "tests the tree leaves a few dozen a line in either case, so that skipping what is inside gains the less",
        f"parts inside take {seconds['boxed'][1] / seconds['flat'][0]:.2f}, the exchange {seconds['boxed'][2]:.2f} s "
        f"beside {seconds['flat'][2]:.2f} s flat",
    ]
    return record


def _seconds(room: Room, is_boxed: bool, lines: int) -> tuple[float, float, float]:
    """CPU seconds of lines through the whole scene, of those through parts, and of the exchange; the best of three."""
    from etendue.radiosity.hierarchical_multipath.exchange import Exchange
    from etendue.radiosity.hierarchical_multipath.lists import lists_of

    method = room.method(is_boxed, lines)
    best = [np.inf] * 3
    for _ in range(3):
        lists: dict[Part, Any] = {}
        spent = [0.0] * 3
        for k, part in enumerate(method.tree.parts):
            points = OwenSobol(4, seed=k)
            begin = time.process_time()
            is_root = part is method.root
            lists[part] = lists_of(
                method._rays[part], is_root, method.lines[part], method._options.regions, lists, points, 0
            )
            spent[0 if is_root else 1] += time.process_time() - begin
        exchange = Exchange(method.tree, lists)
        begin = time.process_time()
        exchange.iterate_until(1e-4, 5)
        spent[2] = time.process_time() - begin
        best = [min(pair) for pair in zip(best, spent, strict=True)]
    return best[0], best[1], best[2]


def _from_lamp(patches: Patches, u: Array) -> tuple[Array, Array]:
    """Rays from the emitters by the cosine law, in coordinates of the patches."""
    lit = np.flatnonzero(patches.emission.any(axis=1))
    face = np.flatnonzero(np.isin(patches.front, lit))[(u[:, 0] * len(lit)).astype(int)]
    a, b, _, c = (patches.vertices[patches.faces[face, k]] for k in range(4))
    rest = (u[:, 0] * len(lit)) % 1
    origin = a + rest[:, None] * (b - a) + u[:, 1:2] * (c - a)
    normal = patches.face_normals[face]
    r, phi = np.sqrt(u[:, 2]), 2 * np.pi * u[:, 3]
    ways = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.sign(normal[:, 2]) * np.sqrt(1 - u[:, 2])])
    return origin + 1e-6 * normal, ways


def memory(
    scenes: Rooms = BOTH,
    lines: Annotated[int, typer.Option(min=1, help="N.")] = 8_000_000,
    out: Out = OUT,
) -> Record:
    """Bytes of the lists of lines (section 5.5 of the thesis)."""
    record = Record(
        f"Memory of lists, N = {lines}", ("", "lines around boxes", "bytes each", "in them", "bytes each", "MB")
    )
    for name in scenes:
        method = Room.of(name).method(True, lines)
        lists = method.cast_lines()
        rows = []
        for is_root in (True, False):
            parts = [part for part in lists if (part is method.root) == is_root]
            count, size = (
                sum(values) for values in zip(*((method.lines[p], lists[p].nbytes) for p in parts), strict=True)
            )
            rows.append((count, size))
        cells = [text for count, size in rows for text in (f"{count}", f"{size / count:.1f}")]
        record.add(name, *cells, f"{sum(size for _, size in rows) / 1e6:.0f}")
    record.notes.append(
        "thesis: 6 million lines around boxes and 1.2 million in them take about 170 MB: 20 and 40 bytes"
    )
    return record


def errors(
    scenes: Rooms = BOTH,
    sequences: Annotated[
        Any, typer.Option("--sequences", parser=named(DRIVERS, "sequence"), help="Names, by commas.", metavar="NAMES")
    ] = "independent,halton,golden weyl",
    lines: Counts = "131072,1048576,4194304",
    seeds: Seeds = 5,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene: error and time by multipath as the thesis has it, by the flat method, and in boxes, and
    what sequences gain (tables 5.2 to 5.7, figure 5.46)."""
    for name in scenes:
        yield _errors(Room.of(name), sequences, lines, seeds)


#: Multipath as the thesis has it: rays from the lamp by the cosine law, then power along lines as they are cast.
#: "flat": rays aimed at patches, lines that are kept and used by each iteration, as by the method with boxes.
_CLASSIC, _FLAT, _BOXES = "classic", "flat", "boxes"


def _errors(room: Room, names: list[str], counts: Sequence[int], seeds: int) -> Record:
    runs = [(kind, name) for kind in (_CLASSIC, _FLAT, _BOXES) for name in names]
    found = {run: np.empty((seeds, len(counts))) for run in runs}
    spent = {run: np.empty((seeds, len(counts))) for run in runs}
    references = room.references(max(counts))
    exact = {is_boxed: np.mean(halves, axis=0) for is_boxed, halves in references.items()}
    noise = max(mean_squared_error(room.patches, *halves) / 4 for halves in references.values())
    scene = RayScene(room.patches)
    for seed in range(-1, seeds):  # the first compiles
        for k, count in enumerate(counts):
            for kind, name in runs:
                boxed = kind == _BOXES
                method = None if kind == _CLASSIC else room.method(boxed, count, name, seed + 1)
                begin = time.process_time()
                if method is None:
                    radiosity = half_and_half(scene, DRIVERS[name], count, seed + 1).radiosity
                else:
                    radiosity = room.solved(method)
                if seed >= 0:
                    spent[kind, name][seed, k] = time.process_time() - begin
                    found[kind, name][seed, k] = mean_squared_error(room.patches, radiosity, exact[boxed])
    work = {run: found[run] * np.median(spent[run], axis=0) for run in runs}
    totals = Record(
        f"Errors of multipath with and without boxes, {room.title}, {seeds} seeds",
        (
            *("", "sequence", *(f"MSE, N = {n}" for n in counts), "to independent", "CPU s"),
            *(f"MSE x time to {kind}" for kind in (_CLASSIC, _FLAT)),
            *(f"to {_CLASSIC}, N = {n}" for n in counts),
            "thesis",
        ),
    )
    for kind, name in runs:
        run = kind, name
        thesis = {(_CLASSIC, INDEPENDENT): "1", (_BOXES, INDEPENDENT): "0.5", (_BOXES, "halton"): "0.3"}.get(run, "")
        classic, flat = (work[base, INDEPENDENT] for base in (_CLASSIC, _FLAT))
        totals.add(
            *(kind, name, *(f"{value:.4g}" for value in found[run].mean(axis=0))),
            *(_quotient(found[run], found[kind, INDEPENDENT]), f"{np.median(spent[run][:, -1]):.2f}"),
            *(_quotient(work[run], base) for base in (classic, flat)),
            *(f"{work[run][:, k].mean() / classic[:, k].mean():.2f}" for k in range(len(counts))),
            thesis,
        )
    totals.notes += [
        "classic: N rays from the lamp by the cosine law, then power along N lines as they are cast; flat: N rays "
        "aimed at patches, N lines that every iteration uses; boxes: the same with 0.65 N lines around boxes and 0.25 "
        "N in them. Each error is measured from the method's own converged solution; CPU seconds for the largest N",
        "to independent, classic and flat (both by independent numbers): geometric mean over N of quotients of means; "
        "standard errors by the seeds",
        f"noise of the references: {noise:.2g}, {noise / min(f.mean(axis=0)[-1] for f in found.values()):.1%} of the "
        "least error",
    ]
    return totals


def _quotient(one: Array, other: Array) -> str:
    """Of mean squared errors, and its standard error by leaving out seeds."""

    def value(rows: slice | list[int]) -> float:
        return float(np.exp(np.log(one[rows].mean(axis=0) / other[rows].mean(axis=0)).mean()))

    seeds = len(one)
    left = [value([k for k in range(seeds) if k != out]) for out in range(seeds)]
    return f"{value(slice(None)):.2f} ± {np.sqrt((seeds - 1) * np.var(left)):.2f}"


def bias(scenes: Rooms = BOTH, out: Out = OUT) -> Iterator[Record]:
    """A table of each scene: the difference of converged solutions with boxes from those without (figure 5.8), by
    distance from the boxes and by resolution; and a map of it."""
    for name in scenes:
        yield _bias(Room.of(name), out)


def _bias(room: Room, out: Path) -> Record:
    patches, areas = room.patches, room.patches.areas
    distance = np.full(len(patches), np.inf)
    for part, _ in room.boxed.children:
        low, high = part.bounds
        off = np.maximum(np.maximum(low - patches.centres, patches.centres - high), 0)
        distance = np.minimum(distance, np.linalg.norm(off, axis=1))
    zones = {
        "in boxes": distance == 0,
        "to 0.25 m": (distance > 0) & (distance <= 0.25),
        "0.25 to 0.75 m": (distance > 0.25) & (distance <= 0.75),
        "farther": distance > 0.75,
        "all": distance >= 0,
    }
    references = room.references()
    flat = references[False]
    record = Record(
        f"Bias of boxes, {room.title}",
        (
            "places, sectors, rings",
            "zone",
            "share of area",
            "rms, each to its own",
            "rms, to the zone's",
            "mean",
            "bar",
        ),
    )
    for grid, sectors, rings in ((4, 4, 2), (8, 8, 4)):
        halves = references[True]
        if (grid, sectors, rings) != (4, 4, 2):
            finer: Any = {"grid": grid, "sectors": sectors, "rings": rings}
            methods = [room.method(True, _REFERENCE, seed=9000 + k, **finer) for k in range(2)]
            halves = room.solved(methods[0], _PASSES), room.solved(methods[1], _PASSES)
        apart: Any = [half - one for half, one in zip(halves, flat, strict=True)]
        relative: Any = [one / np.maximum(exact, 1e-12) for one, exact in zip(apart, flat, strict=True)]
        for zone, chosen in zones.items():
            weight: Any = areas[chosen, None] * np.ones(patches.channels)
            scale = (weight * (flat[0] * flat[1])[chosen]).sum()
            squares = (
                (weight * relative[0][chosen] * relative[1][chosen]).sum() / weight.sum(),
                (weight * apart[0][chosen] * apart[1][chosen]).sum() / scale,
            )
            mean = (weight * (apart[0] + apart[1])[chosen]).sum() / (weight * (flat[0] + flat[1])[chosen]).sum()
            each, rms = (np.sign(square) * np.sqrt(abs(square)) for square in squares)
            bar = verdict(each, 0.02) if zone in ("0.25 to 0.75 m", "farther") else ""
            share = f"{areas[chosen].sum() / areas.sum():.0%}"
            name = f"{grid}x{grid}, {sectors}, {rings}"
            record.add(name, zone, share, f"{each:.2%}", f"{rms:.2%}", f"{mean:+.2%}", bar)
        if grid == 4:
            lumped = np.abs((relative[0] + relative[1]) / 2).max(axis=1)
            _picture(room, lumped, out / f"bias-{room.name}.png")
    record.notes += [
        "differences of radiosities, to that of each patch and to the root mean square of the zone; noise is taken "
        "off by two independent halves. In boxes some patches are all but dark (5 mm below a plate): what is wrong "
        "there by little is wrong by a multiple",
        f"map: bias-{room.name}.png, the relative difference of the worst channel, noise included; black 0.2 % to "
        "yellow 20 %",
    ]
    return record


def _picture(room: Room, values: Array, path: Path) -> None:
    """Values of patches as seen from a corner of the room, in false colours."""
    patches = room.patches
    low, high = patches.bounds
    eye, middle = low + (high - low) * [0.03, 0.03, 0.9], low + (high - low) * [0.62, 0.6, 0.15]
    forward = (middle - eye) / np.linalg.norm(middle - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    x, y = np.meshgrid(np.linspace(-1, 1, 640), np.linspace(0.75, -0.75, 480))
    ways = forward + x[..., None] * right + y[..., None] * np.cross(right, forward)
    ways = (ways / np.linalg.norm(ways, axis=2, keepdims=True)).reshape(-1, 3)
    scene = RayScene(patches)
    seen = scene.first_patches(np.broadcast_to(scene.local(eye), ways.shape), ways)
    shown = np.append(values, [np.nan, np.nan])[seen].reshape(x.shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, false_colour(shown, 0.002, 0.2))
