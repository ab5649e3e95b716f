"""The point sets by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from etendue.core import suggest

from .independent import Independent, LatinHypercube
from .kronecker import ExactPiPowers, PiPowers, Weyl
from .pointset import PointSet, PointSetError, RandomShift
from .radical import FaureBlockHalton, FaureHalton, Halton, Hammersley
from .sobol import OwenSobol, Sobol

_SEQUENCES: tuple[type[PointSet], ...] = (
    *(Independent, Halton, FaureHalton, FaureBlockHalton, Sobol, OwenSobol, Weyl, Hammersley, LatinHypercube),
    *(PiPowers, ExactPiPowers),
)
#: Point sets that need a number of points.
_FIXED = (Hammersley, LatinHypercube, ExactPiPowers)
_SHIFT = "+shift"


def point_sets() -> Mapping[str, type[PointSet]]:
    """Names and classes of the point sets."""
    return MappingProxyType({kind.name: kind for kind in _SEQUENCES})


def has_size(kind: type[PointSet]) -> bool:
    """Whether a point set of this class needs a number of points."""
    return kind in _FIXED


def point_set(name: str, dimension: int, size: int | None = None, seed: int = 0) -> PointSet:
    """The point set ``name`` (see :func:`point_sets`) in ``dimension`` dimensions; ``NAME+shift`` adds a random shift.

    ``size``: for sets that need a number of points; ``seed``: for random ones; others ignore them. Raises
    :class:`PointSetError` for an unknown name or invalid arguments.
    """
    bare = name.removesuffix(_SHIFT)
    kinds = point_sets()
    if bare not in kinds:
        raise PointSetError(f"there is no point set '{name}'; {suggest(bare, kinds)}")
    kind: Any = kinds[bare]
    arguments: list[int] = [dimension]
    if has_size(kind):
        if size is None:
            raise PointSetError(f"{bare} needs a number of points; give a size")
        arguments.append(size)
    points: PointSet = kind(*arguments, seed) if kind.is_random else kind(*arguments)
    return RandomShift(points, seed) if name.endswith(_SHIFT) else points
