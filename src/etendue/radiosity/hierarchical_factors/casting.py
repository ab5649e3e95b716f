"""Hierarchical form factors in passes, as a method of the engine."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from etendue.core import CheckpointError, Measurement, Settings as AnySettings, seed_key, setting
from etendue.points import PointSet
from etendue.surfaces import Objects, Patches

from ..casting import SEGMENTS, CastingSettings, LineCasting
from ..errors import RadiosityError, check_no_period
from ..lines.abuffer import wanted_lines
from ..lines.engine import LineEngine, warn_of_faults
from ..lines.segments import Pairs
from ..lines.sequences import LINE_POINTS, line_points
from ..lines.spiral import SpiralPoints
from ..problem import PatchProblem
from .allocation import MAIN_SHARE, allocated, area_shares, least_error_shares
from .lines import TreeBundles, TreeRays
from .segments import OUTSIDE, PartialSegments
from .tree import sphere_tree

#: Smallest number of lines of a bundle by rays, in total and per sphere.
_LINES, _LINES_PER_SPHERE = 4096, 32


@dataclass(frozen=True, kw_only=True)
class HierarchicalCastingSettings(CastingSettings):
    """Settings that determine the lines. A *bundle* is cast in all spheres, by their shares: parallel lines in each
    sphere or, with rays, as many single lines."""

    lines: float = setting(0.0, "lines of a bundle in all spheres together, 0 for the engine's choice", minimum=0)
    shot: bool = setting(False, "no shot: it is for light")
    local_rays: bool = setting(False, "no local rays: lines in small spheres take their place")
    engine: str = setting("rays", "line by line, or rasterised bundles", choices=("rays", "bundles"))
    point_set: str = setting(
        "auto",
        "what draws the lines; auto takes sobol for rays, spiral for bundles",
        choices=("auto", *LINE_POINTS, "spiral"),
    )
    main_share: float = setting(
        MAIN_SHARE, "share of the lines in the sphere around the scene; 0 chooses all shares by least error", minimum=0
    )
    objects_digest: str = setting("", "")


class HierarchicalCasting(LineCasting):
    """Lines in spheres around the objects of a scene, and through all of it [Castro 2002, ch. 4].

    The form factors of small patches, which few lines of the whole scene meet, come from lines of the spheres around
    them.

    objects: the objects of the patches of :meth:`prepare`. goal: ``rows`` or ``None``.
    """

    name: ClassVar[str] = "spheres"
    Settings: ClassVar[type[AnySettings]] = HierarchicalCastingSettings
    citations: ClassVar[tuple[str, ...]] = ("Castro2002", "Sbert1993")

    def __init__(
        self,
        objects: Objects,
        settings: HierarchicalCastingSettings | None = None,
        *,
        goal: Literal["rows"] | None = None,
        most: int | None = None,
    ) -> None:
        settings = settings or HierarchicalCastingSettings()
        if settings.main_share > 1:
            raise RadiosityError(f"the main sphere has at most all of the lines, not {settings.main_share:g}")
        if settings.engine == "rays" and settings.point_set == "spiral":
            raise RadiosityError(f"a spiral is for bundles; rays take {', '.join(LINE_POINTS)}")
        if settings.shot or settings.local_rays or settings.replicates > 1:
            raise RadiosityError("form factors by a hierarchy have neither shot nor local rays nor replicates")
        mark = hashlib.blake2b(objects.of_patch.tobytes(), digest_size=8).hexdigest()
        if settings.objects_digest not in ("", mark):
            raise CheckpointError("the checkpoint was made with other objects; find them as they were, or cast anew")
        super().__init__(settings.replace(objects_digest=mark), goal=goal, most=most)
        self.objects = objects

    def prepare(self, problem: PatchProblem, seed: int) -> None:
        """See :class:`LineCasting`."""
        known = self.objects.patches
        if len(known) != len(problem.patches) or not np.array_equal(known.areas, problem.patches.areas):
            raise RadiosityError("the objects are of other patches: find those of these patches")
        self.tree = sphere_tree(self.objects)
        super().prepare(problem, seed)

    def segments(self, measurement: Measurement) -> PartialSegments:  # type: ignore[override]
        """The segments of all bundles. Warns as :meth:`LineEngine.cast` does."""
        segments = self._lines(measurement)
        warn_of_faults(segments)
        return segments

    def for_workers(self) -> tuple[str | None, dict[str, Any]]:
        """See ``core.Method``: with the objects."""
        arrays = {name: getattr(self.objects, name) for name in ("of_patch", "areas", "lower", "upper")}
        return f"{__name__}:casting_around", arrays | {"names": np.array(self.objects.names, dtype=str)}

    def _pilot(self, first: int, count: int) -> Iterator[Pairs]:
        return (chunk & ~OUTSIDE for chunk in super()._pilot(first, count))

    @property
    def _hierarchy(self) -> HierarchicalCastingSettings:
        return cast(HierarchicalCastingSettings, self._options)

    def _engine_for(self, patches: Patches) -> LineEngine:
        check_no_period(patches, "method spheres")
        options, tree = self._hierarchy, self.tree
        shares = area_shares(tree, options.main_share) if options.main_share else least_error_shares(tree)
        sequences = [self._points(node) for node in range(len(tree))]
        if options.engine == "bundles":
            return TreeBundles(tree, sequences, (options.lines or min(wanted_lines(patches))) * shares)
        lines = int(options.lines) or max(_LINES, _LINES_PER_SPHERE * len(tree))
        return TreeRays(tree, self._scene, sequences, allocated(lines, shares))

    def _points(self, node: int) -> PointSet:
        """The point set of a sphere."""
        name = self._hierarchy.point_set
        if name == "auto":
            name = "sobol" if self._hierarchy.engine == "rays" else "spiral"
        if name == "spiral":
            return SpiralPoints(seed_key(self._seed, "lines", node)[0])
        return line_points(name, self._seed, "lines", node)

    def _part(self, chunks: Sequence[Pairs]) -> PartialSegments:  # type: ignore[override]
        return PartialSegments(self.tree, chunks, cast(TreeRays, self.engine).densities(1))

    def _lines(self, measurement: Measurement) -> PartialSegments:  # type: ignore[override]
        engine = cast(TreeRays, self.engine)
        return PartialSegments(
            self.tree, list(measurement.records[SEGMENTS]), engine.densities(self.bundles(measurement))
        )


def casting_around(
    settings: HierarchicalCastingSettings, problem: PatchProblem, names: NDArray[Any], **objects: Any
) -> HierarchicalCasting:
    """The method in a worker."""
    return HierarchicalCasting(Objects(problem.patches, names=tuple(map(str, names)), **objects), settings)
