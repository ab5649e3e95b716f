"""Hierarchical multipath in passes, as a method of the engine."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from etendue.core import (
    Array,
    Iterations,
    Measurement,
    Method,
    Pass,
    Result,
    Settings as AnySettings,
    State,
    free_memory,
    logger,
    seed_key,
    setting,
)
from etendue.points import PointSet
from etendue.scene import Problem
from etendue.surfaces import Patches

from ..errors import RadiosityError, check_no_period
from ..lines.engine import warn_of_backs
from ..lines.generators import SINGLE_LINES
from ..lines.sequences import LINE_POINTS, line_points
from ..problem import PatchProblem
from .exchange import Exchange
from .firstshot import FirstShots
from .grouping import GroupSettings
from .light import Shot
from .lists import Lists, PartRays, preprocess
from .parts import Part, Tree
from .regions import Regions
from .solution import HierarchicalSolution

#: Default number of lines of a pass: for each patch of distinct parts, and for each region of a box.
_LINES_PER_PATCH, _LINES_PER_REGION = 16, 2
#: Smallest default number of lines of a pass.
_FEWEST = 1 << 14
#: Bytes of a line of the whole scene and of an inner part, measured in rooms and halls.
BYTES_OUTSIDE, BYTES_INSIDE = 40, 12
#: Smallest number of passes from which an error is estimated.
_LEAST_PASSES = 8
#: Share of the light that may be unshot at the end without a warning.
_MUCH = 0.05

#: Makes points of four dimensions for a purpose and a seed.
MakePoints = Callable[[str, int], PointSet]


@dataclass(frozen=True, kw_only=True)
class HierarchicalMultipathSettings(AnySettings):
    """Lines of a pass, and resolution of boxes."""

    lines: int = setting(0, "lines of a pass, N; 0 for as many as suit the scene", minimum=0)
    shot: float = setting(1.0, "rays of the first shot, in N; 0 sends emission along the lines", minimum=0)
    top: float = setting(0.65, "lines through the whole scene, in N", minimum=0.01)
    inside: float = setting(0.25, "lines through all distinct parts, by their numbers of objects, in N", minimum=0.01)
    grid: int = setting(4, "places along each edge of a face of a box", minimum=1)
    sectors: int = setting(4, "sectors of directions at each of them", minimum=1)
    rings: int = setting(2, "rings of directions at each of them", minimum=1)
    iterations: int = setting(8, "times that stored lines are used, at most", minimum=1)
    residual: float = setting(1e-4, "share of the light that may be on its way at the end", minimum=0)
    point_set: str = setting("sobol", "what draws lines and rays", choices=tuple(LINE_POINTS))
    generator: str = setting(
        "box-walls",
        "how a line through the whole scene is made of a point; in boxes by box-walls",
        choices=SINGLE_LINES,
    )

    @property
    def regions(self) -> Regions:
        """The regions of each box."""
        return Regions(self.grid, self.sectors, self.rings)

    def points_for(self, purpose: str, seed: int) -> PointSet:
        """Points of four dimensions for a purpose and a seed."""
        return line_points(self.point_set, seed, purpose)


@dataclass(frozen=True, kw_only=True)
class BoxSettings(HierarchicalMultipathSettings, GroupSettings):
    """Settings of method ``boxes`` as users give them: of the method, and of the grouping of objects."""


@dataclass(frozen=True)
class PartProblem:
    """A scene of parts as the problem of a job. ``source`` is the name of its source, ``patches`` are all of it in one
    mesh, if parts were made of that, and ``scene`` is the scene that the parts are of."""

    root: Part
    source: str = "<parts>"
    patches: Patches | None = None
    scene: Problem | None = None

    @property
    def parts(self) -> list[Part]:
        """The distinct parts, inner ones first."""
        return self.root.distinct

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of all parts and their places; the same in every process."""
        digest = hashlib.blake2b(digest_size=16)
        number = {id(part): k for k, part in enumerate(self.root.distinct)}
        for part in self.root.distinct:
            own = "" if part.patches is None else PatchProblem(part.patches).fingerprint
            digest.update(f"{own} {part.objects}".encode())
            for copy in part.copies:
                digest.update(f"{number[id(copy.part)]} {copy.transforms.shape}".encode() + copy.transforms.tobytes())
        return digest.hexdigest()


class HierarchicalMultipath(Method):
    """Multipath in boxes around groups of objects or instances, whose copies share their lines [Castro 2002, ch. 5].

    Each pass is a whole solution. Lines are cast through every distinct part, including the root, and stored. A first
    shot sends the emission to patches. Power is then exchanged along the stored lines, from the root down, until little
    of it is unshot. The solution is the mean of the passes; their variance gives its error. Only one pass is in memory.
    A sample of a budget is a line; a pass has N of them. The error is the *square* of the standard error of the
    irradiance, averaged over the surface, relative to the mean irradiance, from the variance of the passes.

    Light that crosses a box is known by region of the box only: see :class:`Regions`. This bias does not fall with more
    lines, but with finer regions, which need more lines.

    settings: see :class:`HierarchicalMultipathSettings`. points: makes points in place of those of the settings.
    """

    name: ClassVar[str] = "boxes"
    counts: ClassVar[str] = "passes"
    Settings: ClassVar[type[AnySettings]] = HierarchicalMultipathSettings
    has_fast_noise: ClassVar[bool] = False
    citations: ClassVar[tuple[str, ...]] = ("Sbert1996", "Castro2002")

    def __init__(self, settings: HierarchicalMultipathSettings | None = None, points: MakePoints | None = None) -> None:
        self._options = self._given = settings or HierarchicalMultipathSettings()
        #: Including the number of lines of a pass once :meth:`prepare` has chosen it, since it determines the passes.
        self.settings: AnySettings = self._options
        self._points = points or self._options.points_for

    @property
    def samples_per_iteration(self) -> int:
        """Lines of a pass, N."""
        return self._options.lines

    def prepare(self, problem: PartProblem, seed: int) -> None:
        """Build the arrays for ray casting. Raises :class:`RadiosityError` if nothing emits, and if the lists and the
        power of all patches do not fit into memory."""
        for part in problem.parts:
            if part.patches is not None:
                check_no_period(part.patches, "method boxes")
        self.root, self._seed = problem.root, seed
        self.tree = Tree(problem.root)
        emits = [part.patches is not None and bool(part.patches.emission.any()) for part in self.tree.parts]
        sky = problem.root.patches is not None and bool(problem.root.patches.sky.any())
        if not (any(emits) or sky):
            raise RadiosityError("no patch emits light, nor does the sky: give one an emission above zero")
        *inner, root = self.tree.parts
        self._rays = {part: PartRays(part) for part in inner} | {root: PartRays(root, self._given.generator)}
        self._options = self.settings = self._given.replace(lines=self._given.lines or self._enough())
        self.lines = self._shared_out()
        self._check_memory()
        self._shots = FirstShots(self.tree, self._rays) if self._options.shot and any(emits) else None

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """A solution with new lines."""
        if seed != self._seed:
            raise RadiosityError(f"lines of seed {seed} are cast by what was prepared with that seed, not {self._seed}")
        options = self._options
        lists, shot = self.cast_lines(iteration), self._first_shot(iteration)
        exchange = Exchange(self.tree, lists, shot)
        left = exchange.iterate_until(options.residual, options.iterations)
        sums = {"received": exchange.received.by_node(self.tree)}
        for name in ("sent", "absorbed", "to_sky", "lost", "residual"):
            sums[name] = getattr(exchange, name)
        del exchange.unshot
        nbytes = sum(lines.nbytes for lines in lists.values())
        return Pass(self._measured(iteration, sums, left, 0 if shot is None else shot.rays, nbytes), state)

    def _first_shot(self, iteration: int) -> Shot | None:
        """The first shot of a pass; ``None`` if lines transport the emission."""
        if self._shots is None:
            return None
        options, seed = self._options, self._seed
        rays = options.shot * options.lines
        return self._shots.cast(rays, self._points("first shot", seed), iteration, seed_key(seed, "shifts", 0)[0])

    def _measured(
        self, iteration: int, sums: dict[str, Array], left: float, shot_rays: int, nbytes: int
    ) -> Measurement:
        """The measurement of a pass. ``left``: share of the light that is unshot. ``nbytes``: size of the lists."""
        if left > _MUCH:
            logger.warning(
                "%.0f %% of the light is still on its way after %d iterations: set more of these, or more lines",
                *(100 * left, self._options.iterations),
            )
        rays = float(sum(self.lines.values()) + shot_rays)
        return Measurement(
            sums,
            dict.fromkeys(sums, 1.0),
            Iterations.single(iteration),
            squares={"received": sums["received"] ** 2},
            counters={"rays": rays, "bytes of lists": float(nbytes)},
        )

    def cast_lines(self, iteration: int = 0) -> dict[Part, Lists]:
        """The stored lines of a pass, by part."""
        regions = self._options.regions
        return preprocess(
            self._rays, self.root, self.lines, regions, lambda k: self._points(f"part {k}", self._seed), iteration
        )

    def solution(self, measurement: Measurement) -> HierarchicalSolution:
        """The mean of the passes. Warns if much light is lost to backs of faces."""
        means = {name: measurement.mean(name) for name in measurement.sums}
        warn_of_backs(
            float((means["lost"] / np.where(means["sent"] > 0, means["sent"], 1)).max()), "of the light meets"
        )
        error = None
        if len(measurement.iterations) > 1:
            error = np.sqrt(np.maximum(measurement.variance_of_mean("received"), 0))
        return HierarchicalSolution(tree=self.tree, error=error, **means)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture, only the numbers of lines and rays."""
        lines = self.samples_per_iteration * len(measurement.iterations)
        return Result({}, {"lines": lines, "rays": int(measurement.counters["rays"])})

    def noise(self, measurement: Measurement) -> float | None:
        """Square of the relative standard error of the irradiance; ``None`` for fewer than 8 passes."""
        if len(measurement.iterations) < _LEAST_PASSES:
            return None
        light = measurement.mean("received").sum()
        error = np.sqrt(np.maximum(measurement.variance_of_mean("received"), 0)).sum()
        return float((error / light) ** 2) if light > 0 else None

    def _enough(self) -> int:
        """Default lines of a pass: some for every patch of distinct parts, and for every region of every box."""
        options, regions = self._options, len(self._options.regions)
        patches = sum(map(len, self.tree.parts))
        need = [_FEWEST, _LINES_PER_PATCH * patches]
        for part in self.tree.parts:
            share = options.top if part is self.root else options.inside * self._share(part)
            for child, transform in part.children:
                area = child.box_area * np.abs(np.linalg.det(transform[:3, :3])) ** (2 / 3)
                need.append(int(_LINES_PER_REGION * regions / 2 * self._rays[part].surface / area / share))
        return max(need)

    def _share(self, part: Part) -> float:
        return part.objects / sum(p.objects for p in self.tree.parts if p is not self.root)

    def _shared_out(self) -> dict[Part, int]:
        """Number of lines of each distinct part."""
        options = self._options
        shares = {
            part: options.top if part is self.root else options.inside * self._share(part) for part in self.tree.parts
        }
        return {part: max(round(share * options.lines), 1) for part, share in shares.items()}

    def _check_memory(self) -> None:
        check_memory(self._options, self.lines, self.root.total, len(self.tree), self.root.channels)


def check_memory(
    options: HierarchicalMultipathSettings,
    lines: Mapping[Part, int],
    patches: int,
    boxes: int,
    channels: int,
    tables: int = 2,
) -> None:
    """Raise :class:`RadiosityError` if memory does not hold the lists of ``lines`` of each part, the power of
    ``patches``, and ``tables`` arrays of the power at the regions of ``boxes``."""
    lists = sum((BYTES_OUTSIDE if part.children else BYTES_INSIDE) * n for part, n in lines.items())
    # Six arrays by patch: received and unshot power; sums and squares of a pass, and those of all passes. Two of the
    # tables by region of a box: the power that waits to enter and to leave.
    regions = len(options.regions) * boxes
    power = 8 * (6 * patches + tables * regions) * channels
    free = free_memory()
    if free is not None and lists + power > free:
        raise RadiosityError(
            f"{options.lines} lines a pass, {patches} patches and {regions} regions of boxes need "
            f"{(lists + power) / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: set fewer lines, a smaller grid of "
            "boxes, or larger patches"
        )
