"""Form factors by local lines: the three classical estimators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, sparse
from etendue.points import OwenSobol, PointSet
from etendue.surfaces import BATCH, STEP, RayScene, RaySource, Sides, cosine_lanes, even_lanes

from ..errors import RadiosityError, check_no_period
from ..lines.engine import warn_of_backs
from .covered import CoveredSides
from .formfactors import FormFactors, numbers_of

Index = NDArray[np.int64]


def local_form_factors(
    scene: RayScene,
    samples: int,
    estimator: Literal["cosine", "angles"] = "cosine",
    rows: ArrayLike | None = None,
    points: PointSet | None = None,
    tell: Callable[[str], object] = lambda text: None,
) -> FormFactors:
    """Form factors from ``samples`` rays of each patch, or only of the patches ``rows``.

    ========== ================================== ==================================================
    ``cosine`` directions of cosine density       F_ij = hits of j / N
    ``angles`` angles theta and phi evenly spread F_ij = pi / N times the sum of cos theta sin theta
    ========== ================================== ==================================================

    [Castro 2002, sec. 2.3.1]. Errors are those of independent rays. ``points`` of four dimensions, by default a
    scrambled Sobol' sequence; each row takes the next ``samples`` of them. ``tell`` receives the progress. Rays that
    start where solids touch meet the other solid. Warns if much of what patches see is backs of faces. Raises
    :class:`RadiosityError` for another estimator, rows that are no patches, fewer than two samples, and faces on each
    other of which it is not known which one is in front (see :func:`exact_form_factors`).
    """
    n = len(scene.patches)
    laws = {"cosine": cosine_lanes, "angles": even_lanes}
    if estimator not in laws:
        raise RadiosityError(f"rays leave by 'cosine' or by 'angles', not {estimator!r}")
    chosen = np.arange(n) if rows is None else np.atleast_1d(np.asarray(rows))
    if chosen.dtype.kind not in "iu" or chosen.size == 0 or chosen.min() < 0 or chosen.max() >= n:
        raise RadiosityError(f"rows are numbers of patches from 0 to {n - 1}")
    if samples < 2:
        raise RadiosityError(f"a form factor with its error needs at least two rays, not {samples}")
    chosen = np.unique(chosen[~scene.patches.empty[chosen]])
    points, sides = points or OwenSobol(4), Sides.of(scene.patches)
    source, covered = RaySource(scene, sides), CoveredSides(scene, sides, chosen, clashing=True)
    parts: tuple[list[Any], list[Any]] = [], []
    at_once = max(BATCH // samples, 1)
    for start in range(0, len(chosen), at_once):
        tell(f"rays, {100 * start // len(chosen)} %")
        here = chosen[start : start + at_once]
        row = np.repeat(here, samples)
        u = points.lanes(mi.UInt32, len(row), start * samples)
        places, ways = source.of(mi.UInt32(row.astype(np.uint32)), u[0], u[1]), laws[estimator](u[2], u[3])
        # With uniform angles each ray has the weight pi cos theta sin theta.
        weights = dr.pi * ways.z * dr.sqrt(1 - ways.z**2) if estimator == "angles" else dr.full(mi.Float, 1, len(row))
        hits = covered.meets(places, scene.meets(places.origin, places.directions(ways)))
        dr.eval(hits, weights)
        found, weight = np.array(hits), np.array(weights, dtype=np.float64)
        place = np.repeat(np.arange(len(here)), samples), found
        for part, of_rays in zip(parts, (weight, weight**2), strict=True):
            part.append(sparse().coo_array((of_rays, place), shape=(len(here), n + 2)).tocsr())
    sums, squares = (_spread(part, chosen, (n, n + 2)) for part in parts)
    mean = (sums / samples).tocsr()
    # Both sums have the same entries; a difference of sparse matrices would drop those without variance.
    mean.sort_indices()
    squares.sort_indices()
    errors = mean.copy()
    errors.data = np.sqrt(np.maximum(squares.data / samples - mean.data**2, 0.0) / (samples - 1))
    lines = np.zeros(n, np.int64)
    lines[chosen] = samples
    sky, dark = np.asarray(mean[:, [n, n + 1]].todense()).T
    numbers, areas = numbers_of(scene.patches), scene.patches.areas
    warn_of_backs(float(dark @ areas / max(areas[chosen].sum(), 1e-300)), "of what patches see is")
    return FormFactors(mean[:, :n].tocsr(), errors.tocsr()[:, :n], sky, areas, lines, dark, **numbers)


def _spread(parts: Sequence[Any], rows: Index, shape: tuple[int, int]) -> Any:
    """A matrix with the rows of parts, one after the other, at ``rows``, which ascend, and no entries in others."""
    if not parts:
        return sparse().csr_array(shape)
    stacked, counts = sparse().vstack(parts, format="csr"), np.zeros(shape[0], np.int64)
    counts[rows] = np.diff(stacked.indptr)
    starts = np.concatenate([[0], np.cumsum(counts)])
    return sparse().csr_array((stacked.data, stacked.indices, starts), shape=shape)


def area_form_factors(
    scene: RayScene, pairs: ArrayLike, samples: int, points: PointSet | None = None
) -> tuple[Array, Array]:
    """Form factors F_ij of ``pairs`` (k, 2), from uniform points on both patches, and standard errors: (k,), (k,).

    F_ij = A_j / (pi N) times the sum of V cos cos' / r^2 [Castro 2002, sec. 2.3.1]. The variance is infinite for
    patches that share an edge. Other arguments as in :func:`local_form_factors`. Raises :class:`RadiosityError` for
    pairs that are no patches, fewer than two samples, and patches with a period.
    """
    check_no_period(scene.patches, "form factors of pairs")
    chosen = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    n = len(scene.patches)
    if chosen.size == 0 or chosen.min() < 0 or chosen.max() >= n:
        raise RadiosityError(f"pairs are numbers of patches from 0 to {n - 1}")
    if samples < 2:
        raise RadiosityError(f"a form factor with its error needs at least two rays, not {samples}")
    points, sides = points or OwenSobol(4), Sides.of(scene.patches)
    values, errors = np.empty(len(chosen)), np.empty(len(chosen))
    for k, (i, j) in enumerate(chosen):
        u = points.block(samples, k * samples)
        ends = []
        for patch, first in ((i, 0), (j, 2)):
            side, within = sides.pick_of(np.full(samples, patch), u[:, first])
            ends.append((side, sides.points(side, np.column_stack([within, u[:, first + 1]]))))
        (from_side, a), (to_side, b) = ends
        kernel = _seen_kernel(scene, sides, from_side, a, to_side, b, int(j))
        x = scene.patches.areas[j] / scene.radius**2 / np.pi * kernel
        values[k], errors[k] = x.mean(), x.std(ddof=1) / np.sqrt(samples)
    return values, errors


def _seen_kernel(scene: RayScene, sides: Sides, from_side: Index, a: Array, to_side: Index, b: Array, to: int) -> Array:
    """V cos cos' / r^2 between points, in unit coordinates."""
    way = b - a
    square = (way**2).sum(axis=1)
    way /= np.sqrt(square)[:, None]
    cosines = (way * sides.normals[from_side]).sum(axis=1), -(way * sides.normals[to_side]).sum(axis=1)
    faces = (cosines[0] > 0) & (cosines[1] > 0)
    seen = np.zeros(len(a), dtype=bool)
    found = scene.first_patches(a[faces] + STEP * sides.normals[from_side[faces]], way[faces])
    seen[np.flatnonzero(faces)] = found == to
    return np.where(seen, cosines[0] * cosines[1] / np.maximum(square, 1e-300), 0.0)
