r"""Primary sample space Metropolis light transport.

The random numbers of a path are a point u of the unit cube, and t(u) > 0 is the luminance of its contributions. Markov
chains of density t / b walk through the cube, many at the same time, by small steps around their states and
large steps anywhere [Kelemen 2002]. Light that independent paths find rarely is explored once a chain is there.

Limit: chains explore only light that independent samples of the same estimator have found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from etendue.core import OptionError, UnsupportedError, setting
from etendue.scene import Problem

from ..base import ImageMethod, ImageSettings
from ..bidirectional import Bpt
from ..path import DirectionSettings
from .bidirectional import PairTarget
from .method import MetropolisMethod, MetropolisSettings, beside_paths
from .targets import PathTarget, Target


@dataclass(frozen=True)
class PssmltSettings(DirectionSettings, MetropolisSettings):
    """Settings of ``pssmlt``."""

    estimator: str = setting(
        "path",
        "paths that the chains mutate: camera paths as of path (path), or pairs of a light path and a camera path, all "
        "of whose vertices are connected with each other (bidirectional)",
        choices=("path", "bidirectional"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.estimator != "path" and not self.bsdf_sampling:
            raise OptionError("bsdf_sampling=false is possible with estimator=path only; leave one of them out")


class Pssmlt(MetropolisMethod):
    """Chains over the random numbers of camera paths, or of pairs of camera and light paths."""

    name: ClassVar[str] = "pssmlt"
    Settings: ClassVar[type[ImageSettings]] = PssmltSettings
    settings: PssmltSettings
    citations: ClassVar[tuple[str, ...]] = (
        "Kelemen2002",
        "VeachGuibas1997",
        "Veach1997",
        "Hoberock2010",
        "Andrieu2009",
    )

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`MetropolisMethod`. Raises :class:`UnsupportedError` if materials disperse light: the strong tint
        of its passes of few wavelengths would bias the colour of the picture."""
        super().prepare(problem, seed)
        if self.visibility.disperses:
            raise UnsupportedError("method 'pssmlt' renders no materials that disperse light; use mmlt, vcm or auto")

    def beside(self) -> type[ImageMethod]:
        """See :class:`MetropolisMethod`."""
        return Bpt if self.settings.estimator == "bidirectional" else beside_paths(self)

    def make_target(self, seed: int) -> Target:
        """See :class:`MetropolisMethod`."""
        o = self.settings
        if o.estimator == "bidirectional":
            return PairTarget(self, o.vertices, o.components)
        return PathTarget(self, o.vertices)
