"""Global lines and local rays together: what small patches see, which few lines meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, logger, sparse
from etendue.points import OwenSobol, PointSet
from etendue.surfaces import BATCH, RayScene, RaySource, Sides, cosine_lanes, pairs_of

from ..errors import RadiosityError
from .segments import Pairs, Segments

#: Local rays may be this share of the segments: with what is made of them, they then take about the time of the lines.
_SHARE = 0.125


class MixedSegments(Segments):
    """Segments of global lines, and of local rays from some of the patches.

    Of the ``m_i`` lines that should meet patch i, ``m_i F_ij`` lead to j, of ``k_i`` rays from it ``k_i F_ij``. With
    ``extra_i = k_i / m_i`` a pair is met ``1 + extra_i + extra_j`` times as often as by lines alone, and each of its
    segments, whether of a line or a ray, counts one divided by that: the balance heuristic [Veach 1997]. Sums so have
    the mean that lines alone have, and remain symmetric: weight_i F_ij = weight_j F_ji.

    Attributes
    ----------
    extra: (n,) local rays for each line that is expected, zero for most patches.
    rays: number of local rays.
    counted, to_sky, to_dark: (n,) weighted, and no whole numbers any more.
    corrections: of each batch, what rays add to the counts of pairs, and weights take from those of lines: an
        (n + 2, n + 2) CSR array.
    """

    extra: Array

    def __init__(self, lines: Segments, corrections: Sequence[Any], extra: Array, rays: int) -> None:
        self.__dict__.update(lines.__dict__)
        self.extra, self.rays, self.corrections = extra, rays, list(corrections)
        self.correction = sum(self.corrections[1:], start=self.corrections[0])
        n = len(lines.patches)
        self.counted = lines.counted + np.asarray(self.correction.sum(axis=1)).ravel()[:n]
        self.to_sky = lines.to_sky + self._column(n)
        self.to_dark = lines.to_dark + self._column(n + 1)

    def __add__(self, other: Segments) -> Segments:
        """Not to be had: add the segments of lines first. Raises :class:`RadiosityError`."""
        raise RadiosityError("segments with local rays cannot be added: add those of lines, then mix rays in")

    def batch(self, number: int) -> Segments:
        """One batch."""
        return MixedSegments(super().batch(number), [self.corrections[number]], self.extra, self.rays)

    def _gather(self, full: Array) -> Array:
        return super()._gather(full) + (self.correction @ full)[: len(self.patches)]

    def _column(self, other: int) -> Array:
        n = len(self.patches)
        return np.asarray(self.correction[:n, [other]].todense(), dtype=np.float64).ravel()


def with_local_rays(
    segments: Segments, scene: RayScene | None = None, *, least: int = 256, points: PointSet | None = None
) -> Segments:
    """The same segments, and local rays from patches that so few lines meet that ``least`` rays tell more.

    Those are the patches that less than ``least`` lines should meet, by their area. There are fewer rays, by halves,
    if they would be more than an eighth of the segments, but two, whose difference tells the error; where all patches
    are alike, there are none, nor where one ray each would be too many. Rays have single precision: patches below 1e-5
    of the scene's size are beyond them.

    scene: made of the patches if it is not given. points: of four dimensions, for the rays, a scrambled Sobol' sequence
    by default; not those of the lines. Raises :class:`RadiosityError` if rays were mixed in before.
    """
    if isinstance(segments, MixedSegments):
        raise RadiosityError("local rays have been mixed into these segments")
    rays, few = local_rays(segments.expected, len(segments), least)
    if len(few) == 0:
        return segments
    extra = np.zeros(len(segments.patches) + 2)  # sky and darkness send no rays
    extra[few] = rays / segments.expected[few]
    batches = max(segments.batch_count, 1)
    from_lines: list[list[Pairs]] = [[] for _ in range(batches)]
    from_rays: list[list[Pairs]] = [[] for _ in range(batches)]
    is_few = extra > 0
    for chunk, batch in zip(segments.chunks, segments.batches, strict=True):
        from_lines[batch].append(chunk[is_few[chunk[:, 0]] | is_few[chunk[:, 1]]])
    for pairs, number in _rays(scene or RayScene(segments.patches), few, rays, points or OwenSobol(4, seed=1)):
        for batch in range(batches):
            from_rays[batch].append(pairs[number * batches // rays == batch])
    logger.info("%d local rays from each of %d patches that few lines meet", rays, len(few))
    corrections = [
        _weighted(np.concatenate(new), extra) + _weighted(np.concatenate(met), extra, less=1.0)
        for new, met in zip(from_rays, from_lines, strict=True)
    ]
    return MixedSegments(segments, corrections, extra[:-2], rays * len(few))


def local_rays(expected: Array, segments: int, least: int = 256) -> tuple[int, NDArray[np.int64]]:
    """How many rays :func:`with_local_rays` casts from each of which patches."""
    rays = least
    while rays and rays * np.count_nonzero(expected < rays) > _SHARE * segments:
        rays //= 2
    rays = max(rays, 2) if rays else 0
    return rays, np.flatnonzero(expected < rays)


def _weighted(pairs: Pairs, extra: Array, less: float = 0.0) -> Any:
    """Sums (n + 2, n + 2) of what segments count, ``less`` a number each, in both directions."""
    i, j = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    weight = 1 / (1 + extra[i] + extra[j]) - less
    both = np.concatenate([weight, weight]), (np.concatenate([i, j]), np.concatenate([j, i]))
    return sparse().coo_array(both, shape=(len(extra), len(extra))).tocsr()


def _rays(scene: RayScene, patches: NDArray[np.int64], rays: int, points: PointSet) -> Iterator[tuple[Pairs, Any]]:
    """Segments (k, 2) of so many rays from each patch, and the number of each among those of its patch."""
    source = RaySource(scene, Sides.of(scene.patches))
    at_once = max(BATCH // rays, 1)
    for start in range(0, len(patches), at_once):
        patch = mi.UInt32(np.repeat(patches[start : start + at_once], rays).astype(np.uint32))
        u = points.lanes(mi.UInt32, len(patch), start * rays)
        places = source.of(patch, u[0], u[1])
        found = scene.meets(places.origin, places.directions(cosine_lanes(u[2], u[3])))
        yield pairs_of(patch, found), np.arange(len(patch)) % rays
