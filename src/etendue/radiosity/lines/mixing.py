"""Global lines combined with local rays, for small patches that few lines hit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, BackendError, logger, sparse
from etendue.points import OwenSobol, PointSet
from etendue.surfaces import BATCH, RayScene, RaySource, Sides, cosine_lanes, pairs_of

from ..errors import RadiosityError
from ..factors.covered import CoveredSides
from .segments import Pairs, Segments

#: Largest number of local rays, as a share of the segments; the rays then take about as long as the lines, including
#: their processing.
_SHARE = 0.125


class MixedSegments(Segments):
    """Segments of global lines, and of local rays from some of the patches.

    Of the ``m_i`` expected lines of patch i, ``m_i F_ij`` lead to j, and of ``k_i`` rays from patch i, ``k_i F_ij``.
    With ``extra_i = k_i / m_i`` a pair is sampled ``1 + extra_i + extra_j`` times as often as by lines alone. Each
    segment of the pair, of a line or a ray, has the inverse of that factor as weight: the balance heuristic
    [Veach 1997]. Sums then have the same mean as with lines alone, and stay symmetric: weight_i F_ij = weight_j F_ji.

    Attributes
    ----------
    extra: (n,) local rays per expected line, zero for most patches.
    rays: number of local rays of all batches.
    counted, to_sky, to_dark: (n,) weighted, so not whole numbers.
    sky_rays: for each batch the patches (k,) of the rays that lead to the sky, and their directions (k, 3), if those of
        the lines are known.
    corrections: for each batch, the change of the counts of pairs by rays and by the weights of lines: an (n + 2, n +
        2) CSR array.
    """

    extra: Array

    def __init__(
        self,
        lines: Segments,
        corrections: Sequence[Any],
        extra: Array,
        rays: int,
        sky_rays: Sequence[tuple[NDArray[np.uint32], Array]],
    ) -> None:
        self.__dict__.update(lines.__dict__)
        self.sky_rays = list(sky_rays)
        self.extra, self.rays, self.corrections = extra, rays, list(corrections)
        self.correction = sum(self.corrections[1:], start=self.corrections[0])
        n = len(lines.patches)
        self.counted = lines.counted + np.asarray(self.correction.sum(axis=1)).ravel()[:n]
        self.to_sky = lines.to_sky + self._column(n)
        self.to_dark = lines.to_dark + self._column(n + 1)

    def batch(self, number: int) -> Segments:
        """One batch."""
        return MixedSegments(
            super().batch(number), [self.corrections[number]], self.extra, self.rays, [self.sky_rays[number]]
        )

    def without(self, number: int) -> Segments:
        """All batches but one."""
        others, rays = (
            [item for k, item in enumerate(items) if k != number] for items in (self.corrections, self.sky_rays)
        )
        return MixedSegments(super().without(number), others, self.extra, self.rays, rays)

    def sky_counts(self, number_of: Callable[[Array], NDArray[np.int64]], shares: Array) -> Array:
        """See :class:`Segments`; weighted."""
        counts = super().sky_counts(number_of, shares)
        for patch, ways in self.sky_rays:
            np.add.at(counts, (patch, number_of(ways)), 1.0)
        return counts / (1 + self.extra)[:, None]

    def _gather(self, full: Array) -> Array:
        return super()._gather(full) + (self.correction @ full)[: len(self.patches)]

    def _column(self, other: int) -> Array:
        n = len(self.patches)
        return np.asarray(self.correction[:n, [other]].todense(), dtype=np.float64).ravel()


def with_local_rays(
    segments: Segments, scene: RayScene | None = None, *, least: int = 256, points: PointSet | None = None
) -> Segments:
    """The same segments, with local rays from patches that fewer than ``least`` lines hit.

    These are the patches with fewer than ``least`` expected lines, by their area. Each sends ``least`` rays. If rays
    would be more than an eighth of the segments, ``least`` is halved repeatedly, down to two rays, whose difference
    gives the error. No rays are cast if all patches are alike, or if one ray each would be too many. Rays have single
    precision: they cannot resolve patches below 1e-5 of the scene's size. A warning says if patches on faces that lie
    on each other get none, since it is not known which one is in front.

    scene: made from the patches if not given. points: four-dimensional points for the rays, by default a scrambled
    Sobol' sequence; not those of the lines. Raises :class:`RadiosityError` if the segments have local rays already.
    """
    if isinstance(segments, MixedSegments):
        raise RadiosityError("these segments have local rays already")
    rays, few = local_rays(segments.expected, len(segments), least)
    if len(few) == 0:
        return segments
    scene = scene or RayScene(segments.patches)
    sides = Sides.of(segments.patches)
    covered, few = _covered(scene, sides, few)
    if len(few) == 0:
        return segments
    extra = np.zeros(len(segments.patches) + 2)  # sky and dark send no rays
    extra[few] = rays / segments.expected[few]
    batches = max(segments.batch_count, 1)
    from_lines: list[list[Pairs]] = [[] for _ in range(batches)]
    from_rays: list[list[Pairs]] = [[] for _ in range(batches)]
    ways: list[list[Array]] = [[] for _ in range(batches)]
    directed = segments.ways is not None
    is_few, none = extra > 0, np.empty((0, 2), np.uint32)  # a batch may have no lines
    for chunk, batch in zip(segments.chunks, segments.batches, strict=True):
        from_lines[batch].append(chunk[is_few[chunk[:, 0]] | is_few[chunk[:, 1]]])
    source = RaySource(scene, sides)
    for pairs, number, directions in _rays(source, covered, few, rays, points or OwenSobol(4, seed=1), directed):
        for batch in range(batches):
            ours = number * batches // rays == batch
            from_rays[batch].append(pairs[ours])
            ways[batch].append(directions[ours & (pairs[:, 1] == len(segments.patches))] if directed else directions)
    logger.info("%d local rays from each of %d patches that few lines meet", rays, len(few))
    corrections = [
        _weighted(np.concatenate(new), extra) + _weighted(np.concatenate([none, *met]), extra, less=1.0)
        for new, met in zip(from_rays, from_lines, strict=True)
    ]
    to_sky = (pairs[pairs[:, 1] == len(segments.patches), 0] for pairs in map(np.concatenate, from_rays))
    nowhere = (np.empty(0, np.uint32), np.empty((0, 3)))
    sky_rays = list(zip(to_sky, map(np.concatenate, ways), strict=True)) if directed else [nowhere] * batches
    return MixedSegments(segments, corrections, extra[:-2], rays * len(few), sky_rays)


def _covered(scene: RayScene, sides: Sides, few: NDArray[np.int64]) -> tuple[CoveredSides, NDArray[np.int64]]:
    """What rays from ``few`` patches meet, and these patches: without those on faces that lie on others, with a
    warning, if it is not known which face is in front."""
    try:
        return CoveredSides(scene, sides, few), few
    except (RadiosityError, BackendError) as error:
        logger.warning("patches on faces that lie on each other get no local rays: %s", error)
        lying = sides.patch[scene.patches.coincident.back_to_back[sides.face]]
        few = np.setdiff1d(few, lying)
        return CoveredSides(scene, sides, few), few


def local_rays(expected: Array, segments: int, least: int = 256) -> tuple[int, NDArray[np.int64]]:
    """Number of rays per patch that :func:`with_local_rays` casts, and the patches that send them."""
    rays = least
    while rays and rays * np.count_nonzero((expected > 0) & (expected < rays)) > _SHARE * segments:
        rays //= 2
    rays = max(rays, 2) if rays else 0
    return rays, np.flatnonzero((expected > 0) & (expected < rays))


def _weighted(pairs: Pairs, extra: Array, less: float = 0.0) -> Any:
    """(n + 2, n + 2) sums over segments, in both directions, of their weight minus ``less``."""
    i, j = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    weight = 1 / (1 + extra[i] + extra[j]) - less
    both = np.concatenate([weight, weight]), (np.concatenate([i, j]), np.concatenate([j, i]))
    return sparse().coo_array(both, shape=(len(extra), len(extra))).tocsr()


def _rays(
    source: RaySource,
    covered: CoveredSides,
    patches: NDArray[np.int64],
    rays: int,
    points: PointSet,
    directed: bool,
) -> Iterator[tuple[Pairs, NDArray[np.int64], Array]]:
    """Segments (k, 2) of ``rays`` rays from each patch, the index of each ray within its patch, and its direction if
    ``directed``."""
    at_once = max(BATCH // rays, 1)
    for start in range(0, len(patches), at_once):
        patch = mi.UInt32(np.repeat(patches[start : start + at_once], rays).astype(np.uint32))
        u = points.lanes(mi.UInt32, len(patch), start * rays)
        places = source.of(patch, u[0], u[1])
        directions = places.directions(cosine_lanes(u[2], u[3]))
        pairs = pairs_of(patch, covered.meets(places, source.scene.meets(places.origin, directions)))
        yield pairs, np.arange(len(patch)) % rays, np.array(directions).T if directed else np.empty((0, 3))
