"""Point sets of lines by name."""

from __future__ import annotations

from etendue.core import seed_key
from etendue.points import Halton, Independent, PointSet, Sobol, Weyl

#: Sobol' points are scrambled, Halton's and Weyl's shifted at random.
LINE_POINTS: dict[str, type[PointSet]] = {kind.name: kind for kind in (Sobol, Halton, Weyl, Independent)}


def line_points(name: str, seed: int, purpose: str, number: int = 0) -> PointSet:
    """Random points of four dimensions, of a kind of :data:`LINE_POINTS`: others for each seed, purpose and number."""
    return LINE_POINTS[name](4).randomised(seed_key(seed, purpose, number)[0])
