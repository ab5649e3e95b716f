"""Results of runs on patches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from etendue.core import InNotebooks

if TYPE_CHECKING:
    from etendue.core import Array, Result
    from etendue.distributed import Correspondence
    from etendue.radiosity import (
        Correction,
        FirstShot,
        FormFactors,
        HierarchicalSolution,
        Lightmap,
        Patches,
        Segments,
        Solution,
    )


@dataclass(kw_only=True)
class FormFactorResult(InNotebooks):
    """Form factors, and the lines from which they are counted: with method ``spheres``
    :class:`etendue.radiosity.PartialSegments`, with ``exact`` none."""

    patches: Patches
    factors: FormFactors
    #: What ``row_sums``, ``reciprocal`` and ``threshold`` changed, if they were asked for.
    correction: Correction | None = None
    #: The factors between groups, if they were asked for.
    groups: FormFactors | None = None
    #: The results of the zones of a building by name, each computed by itself, if there are several.
    zones: Mapping[str, FormFactorResult] | None = None
    segments: Segments | None = None
    #: Bundles that were cast.
    bundles: int = 0
    #: How they were made, as in the files.
    metadata: Mapping[str, Any] = field(default_factory=dict)
    #: The limit that ended the casting: ``seconds``, ``samples`` (bundles), ``error`` or ``cancel``; or ``exact``.
    stopped_by: str
    #: Seconds of this run.
    elapsed: float

    def __repr__(self) -> str:
        return f"<etendue.FormFactorResult {len(self.patches)} patches, {self.bundles} bundles, {self.elapsed:.1f} s>"


@dataclass(kw_only=True)
class RadiosityResult(InNotebooks):
    """A solution. ``patches``, ``solution`` and the error of its irradiance are those of one mesh; ``None`` for a scene
    with copies by method ``boxes`` if no files were requested."""

    patches: Patches | None
    solution: Solution | None
    #: (n, c) standard error of the irradiance; ``None`` if there are no lines, or too few to estimate it.
    irradiance_error: Array | None = None
    #: The limit that ended the casting: ``seconds``, ``samples`` (bundles, lines or passes), ``error`` or ``cancel``;
    #: for solutions without lines ``ambient``.
    stopped_by: str
    #: Seconds of this run.
    elapsed: float
    #: Whether the power that enters leaves again, up to errors; if not, a warning is given.
    is_balanced: bool = True
    #: Method ``lines``: bundles that were cast, and the stored lines.
    bundles: int = 0
    segments: Segments | None = None
    #: Method ``multipath``: points of its lines.
    points: int = 0
    #: Method ``boxes``: passes, the solution of every copy, and with workers that have boxes the messages to each.
    passes: int = 0
    parts: HierarchicalSolution | None = None
    correspondence: Correspondence | None = None
    #: The light of small emitters, if it was sent by local rays.
    shot: FirstShot | None = None
    #: The picture, if a picture file was requested: layers and metadata.
    picture: Result | None = None
    lightmap: Lightmap | None = None

    def __repr__(self) -> str:
        what = "copies" if self.patches is None else f"{len(self.patches)} patches"
        return f"<etendue.RadiosityResult {what}, {self.elapsed:.1f} s, stopped by {self.stopped_by}>"
