"""What comes of lines through patches, and of how many if nobody says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from etendue.core import Array, Result
    from etendue.radiosity import FirstShot, FormFactors, Lightmap, Patches, Segments, Solution

#: Bundles, if no budget is given.
DEFAULT_BUNDLES = 1024


@dataclass
class LinesResult:
    """Lines that were cast."""

    patches: Patches
    segments: Segments
    bundles: int
    #: What ended the casting: ``seconds``, ``samples`` (bundles), ``error`` or ``cancel``.
    stopped_by: str
    #: Seconds of this run.
    elapsed: float


@dataclass
class FormFactorResult(LinesResult):
    """Form factors, and the lines they are counted from."""

    factors: FormFactors


@dataclass
class RadiosityResult(LinesResult):
    """A solution, and the lines that carried its light."""

    solution: Solution
    #: (n, c) standard error of the irradiance; ``None`` where lines cannot tell it.
    irradiance_error: Array | None
    #: The light of small emitters, where that was sent by local rays.
    shot: FirstShot | None = None
    #: The picture, if files of one were asked for: layers, and metadata.
    picture: Result | None = None
    lightmap: Lightmap | None = None
