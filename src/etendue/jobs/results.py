"""Results of work on patches, and the default budgets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from etendue.core import InNotebooks

if TYPE_CHECKING:
    from etendue.core import Array, Result
    from etendue.radiosity import FirstShot, FormFactors, Lightmap, Patches, Segments, Solution

#: Bundles, if no budget is given.
DEFAULT_BUNDLES = 1024
#: Points of multipath, if no budget is given.
DEFAULT_POINTS = 1 << 22


@dataclass(kw_only=True)
class LinesResult(InNotebooks):
    """Base of the results of casting lines."""

    patches: Patches
    #: Bundles that were cast; 0 for multipath, which casts single lines, and for ambient solutions.
    bundles: int = 0
    #: The limit that ended the casting: ``seconds``, ``samples`` (bundles or points), ``error``; or ``cancel``. For
    #: solutions without lines ``ambient``.
    stopped_by: str
    #: Seconds of this run.
    elapsed: float


@dataclass(kw_only=True)
class FormFactorResult(LinesResult):
    """Form factors, and the lines from which they are counted; with a hierarchy,
    :class:`etendue.radiosity.PartialSegments`."""

    factors: FormFactors
    segments: Segments


@dataclass(kw_only=True)
class RadiosityResult(LinesResult):
    """A solution, and the lines that transported its light."""

    solution: Solution
    #: (n, c) standard error of the irradiance; ``None`` if there are no lines, or too few to estimate it.
    irradiance_error: Array | None
    #: Whether the power that enters leaves again, up to errors; if not, a warning is given.
    is_balanced: bool = True
    #: The stored lines; ``None`` for multipath, which stores none.
    segments: Segments | None = None
    #: Points of the lines of multipath; 0 for other solvers.
    points: int = 0
    #: The light of small emitters, if it was sent by local rays.
    shot: FirstShot | None = None
    #: The picture, if a picture file was requested: layers and metadata.
    picture: Result | None = None
    lightmap: Lightmap | None = None
