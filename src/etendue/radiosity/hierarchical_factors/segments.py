"""Segments of lines that were cast in parts of a scene, and their form factors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, free_memory, sparse

from ..errors import RadiosityError
from ..factors.formfactors import Estimator, FormFactors, check_estimator, entries_of, estimate, numbers_of, shares
from ..lines.segments import Pairs
from .tree import SphereTree

Index = NDArray[np.int64]

#: Flag of an end of a segment that does not belong to the sphere of the line.
OUTSIDE = np.uint32(1 << 31)
#: Number of segments that are counted together.
_BLOCK = 1 << 22
#: Bytes of a form factor while it is computed.
_FACTOR_BYTES = 120


def marked(pairs: Pairs, spheres: Index, tree: SphereTree) -> Pairs:
    """Segments (k, 2) of lines of given spheres (k,), without segments that have no end in the sphere of their line. An
    end outside the sphere gets the flag ``OUTSIDE``."""
    first, second = (tree.belong(spheres, pairs[:, end]) for end in range(2))
    kept = np.flatnonzero(first | second)
    result = pairs[kept]
    for end, inside in enumerate((first, second)):
        result[:, end] |= np.where(inside[kept], np.uint32(0), OUTSIDE)
    return result


class PartialSegments:
    """Segments between patches, each of a line that was cast in a sphere of a :class:`SphereTree`.

    Lines of a sphere are uniform inside it: they sample what the patches of the sphere see, inside and outside it, but
    not what other patches see. So the number r_ij of lines that lead from i to j differs from r_ji: lines of a sphere
    to which i belongs, but j does not, count for r_ij only. For each patch r_i = sum_j r_ij, including the sky and the
    backs of faces [Castro 2002, sec. 4.2.4].

    Attributes
    ----------
    chunks: arrays (k, 2) of patches, ``n`` for the sky and ``n + 1`` for the back of a face; ends that do not belong to
        the sphere of the line have ``OUTSIDE`` added.
    densities: (m,) expected lines of each sphere and the spheres above it, through a flat patch of area 1.
    expected, counted: (n,) lines r_i through each patch: expected, if the patch is flat, and counted.
    to_sky, to_dark: (n,) lines from each patch that lead to the sky, and to the back of a face.
    """

    def __init__(self, tree: SphereTree, chunks: Sequence[Pairs], densities: Array) -> None:
        self.tree, self.patches = tree, tree.objects.patches
        self.chunks, self.densities = list(chunks), densities
        self.expected: Array = tree.of_patches(densities) * self.patches.areas
        n = len(self.patches)
        totals = np.zeros((3, n), dtype=np.int64)
        for start, end in self._views():
            totals[0] += np.bincount(start, minlength=n)
            for k in range(2):
                totals[1 + k] += np.bincount(start[end == n + k], minlength=n)
        self.counted, self.to_sky, self.to_dark = totals

    def __len__(self) -> int:
        return sum(map(len, self.chunks))

    def __repr__(self) -> str:
        return f"PartialSegments({len(self)} of {len(self.patches)} patches, {len(self.tree)} spheres)"

    @property
    def unseen(self) -> Index:
        """Patches without any line, whose form factors are unknown; empty patches are none of them."""
        return np.flatnonzero((self.counted == 0) & (self.expected > 0))

    def gather(self, values: ArrayLike) -> Array:
        """Mean of ``values`` (n, c) over the surfaces that each patch sees, zero for the sky: F values, with F1."""
        n = len(self.patches)
        given = np.asarray(values, dtype=np.float64).reshape(n, -1)
        full = np.concatenate([given, np.zeros((2, given.shape[1]))], axis=0)
        sums = np.zeros((n, full.shape[1]))
        for start, end in self._views():
            for column in range(full.shape[1]):
                sums[:, column] += np.bincount(start, full[end, column], n)
        return sums / np.maximum(self.counted, 1)[:, None]

    def counts(self) -> tuple[Any, Any]:
        """Matrices (n, n): the number r_ij of lines that lead from i to j, and how many of these r_ji counts as well.

        Raises :class:`RadiosityError` if the form factors do not fit into memory.
        """
        n = len(self.patches)
        found, both = (sparse().csr_array((n, n)) for _ in range(2))
        for pairs in self._blocks():
            ends = pairs & ~OUTSIDE
            inside = (pairs & OUTSIDE) == 0
            seen = (ends < n).all(axis=1)
            for end in range(2):
                of = seen & inside[:, end]
                found += _counted(ends[of, end], ends[of, 1 - end], n)
            of = seen & inside.all(axis=1)
            one = _counted(ends[of, 0], ends[of, 1], n)
            both += one + one.T
        need, free = _FACTOR_BYTES * found.nnz, free_memory()
        if free is not None and need > free:
            raise RadiosityError(
                f"{found.nnz} form factors of {n} patches need {need / 1e9:.1f} GB; {free / 1e9:.1f} GB are free: cast "
                "fewer lines, or make patches larger"
            )
        return found.tocsr(), both.tocsr()

    def _views(self) -> Iterator[tuple[Index, Index]]:
        """Segment ends that belong to the sphere of the line, and the opposite ends."""
        for pairs in self._blocks():
            ends = (pairs & ~OUTSIDE).astype(np.int64)
            for end in range(2):
                inside = pairs[:, end] < OUTSIDE
                yield ends[inside, end], ends[inside, 1 - end]

    def _blocks(self) -> Iterator[Pairs]:
        """The chunks, joined to larger blocks."""
        waiting: list[Pairs] = []
        for chunk in self.chunks:
            waiting.append(chunk)
            if sum(map(len, waiting)) >= _BLOCK:
                yield np.concatenate(waiting)
                waiting = []
        if waiting:
            yield np.concatenate(waiting)


def partial_form_factors(segments: PartialSegments, estimator: Estimator = "F4") -> FormFactors:
    """Form factors of segments in parts of a scene, see :func:`estimate`; here F4 has the least error.

    ``reciprocal`` and ``pooled`` divide the number of different lines between two patches by the expected or counted
    lines of all spheres to which either patch belongs. Errors are those of independent lines.

    Raises :class:`RadiosityError` for an unknown estimator, and if the form factors do not fit into memory.
    """
    check_estimator(estimator)
    patches, tree = segments.patches, segments.tree
    found, both = segments.counts()
    lines = segments.counted.astype(np.float64)
    if estimator in ("reciprocal", "pooled"):
        matrix = (found + found.T - both).tocoo()
        i, j = matrix.coords
        # Expected lines per area of patch i, of patch j, and of the spheres that both belong to.
        density, common = tree.of_patches(segments.densities), segments.densities[tree.common(i, j)]
        different, relative = density[i] + density[j] - common, 1 / matrix.data
        if estimator == "reciprocal":
            lines = segments.expected
        else:
            counted = lines / patches.divisors
            both_ways = counted[i] + counted[j]
            different *= both_ways / (density[i] + density[j])
            relative += _spread_of_lines(i, j, found, both, lines, patches.areas, matrix.data)
        errors = matrix.copy()
        matrix.data = matrix.data / (patches.areas[i] * different)
        errors.data = matrix.data * np.sqrt(np.maximum(relative, 0))
        matrix, errors = matrix.tocsr(), errors.tocsr()
    else:
        matrix = estimate(found, lines, patches.areas, estimator).tocsr()
        errors = _errors(matrix, found, both, lines, patches.areas, estimator)
    for entries in (matrix, errors):
        entries.sort_indices()
    sky, dark = shares(segments.to_sky, segments.to_dark, lines)
    return FormFactors(matrix, errors, sky, patches.areas, segments.counted, dark, **numbers_of(patches))


def _errors(matrix: Any, found: Any, both: Any, lines: Array, areas: Array, estimator: Estimator) -> Any:
    """Standard errors with the structure of ``matrix``. Some lines are counted in both directions."""
    entries = matrix.tocoo()
    i, j = entries.coords
    there, back, shared = (entries_of(x, i, j) for x in (found, found.T.tocsr(), both))
    m_i, m_j, ratio = lines[i], np.maximum(lines[j], 1), areas[j] / areas[i]
    own, other = there / np.maximum(m_i, 1), back / m_j
    # Variances of the two directions, from their Poisson counts, and their covariance from common lines.
    parts = own * (1 - own) / np.maximum(m_i, 1), ratio**2 * other * (1 - other) / m_j
    common = ratio * shared / (np.maximum(m_i, 1) * m_j)
    weights = {"F1": (1.0, 0.0), "F2": (0.0, 1.0), "F3": (m_i, lines[j]), "F4": (there, back)}[estimator]
    a, b = (w / np.maximum(weights[0] + weights[1], 1e-300) for w in weights)
    entries.data = np.sqrt(np.maximum(a * a * parts[0] + b * b * parts[1] + 2 * a * b * common, 0))
    return entries.tocsr()


def _spread_of_lines(i: Index, j: Index, found: Any, both: Any, lines: Array, areas: Array, different: Array) -> Array:
    """Contribution of the variance of ``r_i / A_i + r_j / A_j`` to the relative variance of entries with that divisor.
    The contribution is negative, since the divisor also counts the ``different`` lines of the entry."""
    there, back, shared = (entries_of(x, i, j) for x in (found, found.T.tocsr(), both))
    a, b = areas[i], areas[j]
    divisor = lines[i] / a + lines[j] / b
    own = (lines[i] / a**2 + lines[j] / b**2 + 2 * shared / (a * b)) / divisor**2
    return np.asarray(own - 2 * (there / a + back / b) / (different * divisor))


def _counted(row: Any, column: Any, n: int) -> Any:
    ones = np.ones(len(row))
    return sparse().coo_array((ones, (row.astype(np.int64), column.astype(np.int64))), shape=(n, n)).tocsr()
