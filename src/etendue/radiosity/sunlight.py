"""Direct light of suns on patches: sunlit shares and irradiances, by bundles of lines along the rays of each sun.

The lines of a bundle along the direction of a sun are its rays. Of those through the front of a patch, the sunlit share
lead to the sky. The irradiance of a patch is E = E_n f P / A, with the irradiance E_n normal to the rays, the sunlit
share f and the area P of the patch projected along the rays, which is known exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, seed_key, short_repr, use_variant
from etendue.lighting import Suns, compass
from etendue.points import OwenSobol
from etendue.surfaces import BATCH, Patches, RayScene, RaySource, Sides

from .errors import RadiosityError, check_up
from .lines.abuffer import ABuffer
from .lines.segments import scatter

#: Bundles of a sun, whose variance gives the error; with fewer expected lines in all of them, a patch sends rays; their
#: number.
_BUNDLES, _FEWEST, _RAYS = 4, 32, 256
#: Bytes for each patch and sun.
_BYTES = 40


@short_repr
@dataclass(frozen=True)
class Sunlight:
    """Direct light of k suns on n patches.

    ``sunlit``, ``error``: (n, k) the lit share of what of each patch faces the sun, and its standard error.
    ``cosine``: (n, k) area facing the sun, projected along its rays, over the area of the patch: the cosine of a flat
    one, 0 of patches that face away.
    """

    patches: Patches
    suns: Suns
    sunlit: Array
    error: Array
    cosine: Array

    @property
    def irradiance(self) -> Array:
        """(n, k), in W/m^2, mean over each patch."""
        result: Array = self.suns.direct_normal * self.cosine * self.sunlit
        return result

    @property
    def irradiance_error(self) -> Array:
        """(n, k) standard error of the irradiance."""
        result: Array = self.suns.direct_normal * self.cosine * self.error
        return result


def sunlight(
    patches: Patches,
    suns: Suns,
    *,
    up: str = "z",
    north: float = 0.0,
    lines: float | None = None,
    seed: int = 0,
    tell: Callable[[str], object] = lambda text: None,
) -> Sunlight:
    """The direct light of suns on patches, with the shadows of all faces. Suns are points, so shadows are sharp.

    up, north: see :func:`etendue.lighting.compass`. lines: of a bundle, see :class:`ABuffer`; four bundles with
    independent shifts of their grids are cast for each sun, and their variance gives the error. Patches that fewer than
    32 of these lines would meet (small ones, and those at which the rays graze) send 256 rays towards the sun instead.
    Suns below the horizon light nothing. Raises :class:`RadiosityError` if the result does not fit into memory.
    """
    check_up(patches, up)
    n, k, free = len(patches), len(suns), free_memory()
    if free is not None and _BYTES * n * k > free:
        raise RadiosityError(
            f"{k} suns on {n} patches need {_BYTES * n * k / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: ask for fewer "
            "suns, or make patches larger"
        )
    ways = suns.directions @ compass(up, north)
    sunlit, error, cosine = np.zeros((3, n, k))
    risen = np.flatnonzero(suns.directions[:, 2] >= 0.0)
    suits = lines is not None or ABuffer.suits(patches)
    engine = ABuffer(patches, lines=lines) if suits else None
    if engine is not None:
        for count, (sun, lit, met) in enumerate(_by_lines(engine, ways, risen, seed)):
            tell(f"sun {count + 1} of {len(risen)}")
            mean = np.divide(lit.sum(axis=0), met.sum(axis=0), out=np.zeros(n), where=met.sum(axis=0) > 0)
            sunlit[:, sun] = mean
            error[:, sun] = scatter(((a[:, None], b) for a, b in zip(lit, met, strict=True)), mean[:, None])[:, 0]
    rays: _Rays | None = None
    for j in risen:
        projected = _projected(patches, ways[j])
        cosine[:, j] = projected / patches.divisors
        met_by = np.zeros(n)
        if engine is not None:
            met_by = _BUNDLES * projected * engine.bundles.density(engine.bundles.frames_along(ways[j : j + 1]))
        few = np.flatnonzero((projected > 0) & (met_by < _FEWEST))
        if len(few):
            rays = rays or _Rays(patches, seed)
            sunlit[few, j], error[few, j] = rays.sunlit(few, ways[j])
    facing = cosine > 0
    return Sunlight(patches, suns, np.where(facing, sunlit, 0.0), np.where(facing, error, 0.0), cosine)


def _by_lines(
    engine: ABuffer, ways: Array, risen: NDArray[np.int64], seed: int
) -> Iterator[tuple[int, NDArray[np.int64], NDArray[np.int64]]]:
    """For each sun its index, and for each of its bundles the lines (b, n) from each patch towards the sun: those that
    lead to the sky, and all."""
    n = len(engine.patches)
    shifts = OwenSobol(2, seed=seed_key(seed, "lines", 0)[0]).block(_BUNDLES * len(risen)).reshape(-1, _BUNDLES, 2)
    grids = (
        (np.repeat(engine.bundles.frames_along(ways[j : j + 1]), _BUNDLES, axis=0), shift)
        for j, shift in zip(risen, shifts, strict=True)
    )
    for j, made in zip(risen, engine.along(grids), strict=True):
        bundle = np.repeat(np.arange(_BUNDLES), made.ways[:, 3].astype(np.int64))
        place = bundle * (n + 2) + made.pairs[:, 0]
        lit, met = (
            np.bincount(rows, minlength=_BUNDLES * (n + 2)).reshape(_BUNDLES, -1)[:, :n]
            for rows in (place[made.pairs[:, 1] == n], place)
        )
        yield int(j), lit, met


def _projected(patches: Patches, way: Array) -> Array:
    """(n,) area of each patch that faces a direction, projected along it."""
    height, n = patches.face_areas * (patches.face_normals @ way), len(patches)
    sums = [
        np.bincount(side[side >= 0], np.maximum(sign * height, 0.0)[side >= 0], n)
        for side, sign in ((patches.front, 1), (patches.back, -1))
    ]
    return np.asarray(sums[0] + sums[1], np.float64)


class _Rays:
    """Rays from points on patches towards suns."""

    def __init__(self, patches: Patches, seed: int) -> None:
        use_variant()
        self._scene = RayScene(patches)
        self._source = RaySource(self._scene, Sides.of(patches))
        self._points = OwenSobol(2, seed=seed_key(seed, "local rays", 0)[0])

    def sunlit(self, patches: NDArray[np.int64], way: Array) -> tuple[Array, Array]:
        """Sunlit shares of ``patches`` (m,), and their standard errors, as of independent rays."""
        import mitsuba as mi

        shares, towards = [], mi.Vector3d(*(dr.opaque(mi.Float64, float(x)) for x in way))
        for start in range(0, len(patches), BATCH // _RAYS):
            some = patches[start : start + BATCH // _RAYS]
            u = self._points.lanes(mi.UInt32, len(some) * _RAYS, 0)
            places = self._source.of(mi.UInt32(np.repeat(some, _RAYS).astype(np.uint32)), u[0], u[1])
            cosine = dr.maximum(dr.dot(places.normal, towards), 0.0)
            free = ~self._scene.hit(places.origin, mi.Vector3f(towards), cosine > 0.0).is_valid()
            sums = [dr.block_sum(x, _RAYS) for x in (dr.select(free, cosine, 0.0), cosine)]
            dr.eval(sums)
            lit, facing = map(np.array, sums)
            shares.append(np.divide(lit, facing, out=np.zeros(len(some)), where=facing > 0))
        share = np.clip(np.concatenate(shares), 0.0, 1.0)
        return share, np.sqrt(share * (1 - share) / _RAYS)
