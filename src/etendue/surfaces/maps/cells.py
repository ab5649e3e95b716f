"""Maps of values of cells, or of the patches of a radiosity solution, and the histogram."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, InNotebooks, is_whole, use_variant
from etendue.scene import RenderSpace

from ..errors import SurfaceError
from ..places import PatchSurfaces, SurfaceValues
from .places import Located, MapSurfaces
from .protocol import Irradiance, SurfaceParticles

if TYPE_CHECKING:
    import mitsuba as mi

Index = NDArray[np.int64]

#: Groups of light paths whose spread gives the standard error.
GROUPS = 8
#: Multiplier of the hash that assigns paths to groups, so that groups do not follow the order of a point set.
_HASH = 2654435761


class PatchMap(InNotebooks):
    """Irradiance of patches: cells with particles, or a radiosity solution.

    Parameters
    ----------
    surfaces: the patches.
    values, errors: (n, 3) or (n, 1), W/m^2, of patches; ``errors`` may be None.
    smooth: interpolate between the patches of a surface; otherwise a value is constant on its patch.
    kind, space: see :class:`SurfaceMap`.

    Raises :class:`SurfaceError` for another number of values, or if they are not finite.
    """

    def __init__(
        self,
        surfaces: PatchSurfaces,
        values: ArrayLike,
        errors: ArrayLike | None = None,
        *,
        smooth: bool = True,
        kind: str = "patches",
        space: RenderSpace | None = None,
    ) -> None:
        use_variant()
        self.surfaces, self.smooth, self.kind, self.space = surfaces, smooth, kind, space or RenderSpace()
        self.values = _colours(values, len(surfaces.patches), "values")
        if not np.isfinite(self.values).all():
            raise SurfaceError("the irradiance of a map is finite everywhere; these values are not")
        self.errors = None if errors is None else _colours(errors, len(surfaces.patches), "errors")

    @cached_property
    def _value(self) -> SurfaceValues:
        if not self.smooth:
            return SurfaceValues(self.surfaces, self.values)
        n = len(self.values)
        return SurfaceValues(self.surfaces, np.zeros((n, 1)), np.ones((n, 1)), self.values)

    @cached_property
    def _error(self) -> SurfaceValues:
        return SurfaceValues(
            self.surfaces, np.full((len(self.values), 1), np.nan) if self.errors is None else self.errors
        )

    def irradiance(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True) -> Irradiance:
        """See :class:`SurfaceMap`."""
        place = self.surfaces.find(p, n, active, self.space)
        return Irradiance(self._value.at(place), self._error.at(place), place.found)


def _colours(values: ArrayLike, count: int, name: str) -> Array:
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 2 or x.shape[0] != count or x.shape[1] not in (1, 3):
        raise SurfaceError(f"{name} of a map have one channel or three for each of {count} patches, not {x.shape}")
    return np.broadcast_to(x, (count, 3))


class HistogramBuilder:
    """Counts particles in cells, pass after pass: irradiance is their power divided by the area of the cell.

    The map is exact at edges and corners, since no cell extends beyond its surface, and blurred by the size of the
    cells. Memory is that of the cells. The standard error is that of the mean over ``groups`` groups of light paths.
    """

    def __init__(self, surfaces: MapSurfaces, groups: int = GROUPS) -> None:
        self.surfaces, self.groups = surfaces, check_groups(groups)
        #: (groups, n, 3) W.
        self.power = np.zeros((groups, len(surfaces.patches), 3))
        self.particles = 0
        self._seen: set[int] = set()

    def add(self, hits: SurfaceParticles) -> None:
        """Add particles; raises as :meth:`MapSurfaces.located`."""
        located = self.surfaces.located(hits)
        self.count(located, self.surfaces.cell_of(*self.surfaces.uploaded(located)))

    def count(self, located: Located, cell: Index) -> None:
        """Add particles whose cells are known; -1 for none."""
        n, on = len(self.surfaces.patches), cell >= 0
        key = group_of(located.path, self.groups)[on].astype(np.int64) * n + cell[on]
        for channel in range(3):
            added = np.bincount(key, located.power[on, channel], self.groups * n)
            self.power[:, :, channel] += added.reshape(self.groups, n)
        self.particles += int(np.count_nonzero(on))
        self._seen |= set(np.unique(located.shape[on]).tolist())

    def build(self, smooth: bool = False) -> PatchMap:
        """The map of all particles so far; warns of surfaces without any. Raises :class:`SurfaceError` for none."""
        if not self.particles:
            raise SurfaceError("there are no particles, so no map: add some first")
        self.surfaces.warn_of_dark(np.array(sorted(self._seen)))
        values, errors = mean_of_groups(self.power / self.surfaces.patches.areas[:, None])
        return PatchMap(
            self.surfaces.places, values, errors, smooth=smooth, kind="histogram", space=self.surfaces.space
        )


def check_groups(groups: int) -> int:
    """The number of groups; raises :class:`SurfaceError` for fewer than 2."""
    if not is_whole(groups) or groups < 2:
        raise SurfaceError(f"a standard error needs two groups of light paths at least, not {groups!r}")
    return int(groups)


def group_of(path: NDArray[np.uint32], groups: int) -> Index:
    """The group (n,) of light paths by their numbers."""
    mixed = (path.astype(np.uint64) + 1) * _HASH & 0xFFFFFFFF
    return ((mixed >> 16) % groups).astype(np.int64)


def mean_of_groups(sums: Array) -> tuple[Array, Array]:
    """(estimate, standard error) from ``sums`` (groups, ...): the contributions of the groups, whose sum is the
    estimate. The error is NaN if all particles are in one group: those of one path, or without path numbers."""
    groups = len(sums)
    if np.count_nonzero(sums.any(axis=tuple(range(1, sums.ndim)))) < 2:
        return sums.sum(axis=0), np.full(sums.shape[1:], np.nan)
    error = (groups * sums).std(axis=0, ddof=1) / np.sqrt(groups)
    return sums.sum(axis=0), error
