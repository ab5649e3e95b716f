"""Form factors as sparse matrices: from counted lines, by several estimators, with corrections of row sums and
reciprocity."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, InNotebooks, free_memory, short_repr, sparse
from etendue.surfaces import Patches

from ..errors import RadiosityError
from ..lines.segments import Pairs, Segments
from .counting import PairCounts

if TYPE_CHECKING:
    import scipy.sparse

#: Estimators of form factors from counts, see :func:`estimate`.
Estimator = Literal["F1", "F2", "F3", "F4", "reciprocal", "pooled"]
#: Arrays of form factors, and of files, that say what their rows are.
NUMBERS = ("face", "label", "name", "zone")
ESTIMATORS: tuple[Estimator, ...] = ("F1", "F2", "F3", "F4", "reciprocal", "pooled")

#: Largest deviation of a repaired row sum from 1.
_INEXACT = 1e-6


@short_repr
@dataclass(frozen=True)
class FormFactors(InNotebooks):
    """F_ij, the share of the light that leaves patch ``i`` and arrives at patch ``j`` directly.

    ``matrix``, ``errors``: (n, n) CSR arrays of SciPy: F, and the standard error of each entry, with the same
    structure.
    ``sky``: (n,) the share that leaves the scene. ``areas``: (n,). ``lines``: (n,) lines or rays behind each row.
    ``dark``: (n,) the share that ends on backs of faces, by default none.
    ``ground``: (n,) the share that leaves the scene downward; ``sky`` is then the rest of what leaves. ``None`` if they
    are not apart, and ``sky`` is both.
    ``sky_patches``: (n, p) the shares of the sky's patches 1 to p of :class:`etendue.lighting.SkyPatches`, which sum to
    ``sky``; ``None`` if they are not known. See :func:`sky_parts`.
    ``face``, ``label``, ``name``, ``zone``: (n,) the first face of each patch, its label, the name of its shape and its
    zone, see :class:`Patches`; ``None`` if they are not known.
    """

    matrix: scipy.sparse.csr_array
    errors: scipy.sparse.csr_array
    sky: Array
    areas: Array
    lines: NDArray[np.int64] | Array
    dark: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.dark is None:
            object.__setattr__(self, "dark", np.zeros(len(self.areas)))

    face: NDArray[np.int64] | None = None
    label: NDArray[np.int64] | None = None
    name: NDArray[np.str_] | None = None
    zone: NDArray[np.str_] | None = None
    ground: Array | None = None
    sky_patches: Array | None = None

    def __len__(self) -> int:
        return len(self.areas)

    @property
    def numbers(self) -> dict[str, Any]:
        """``face``, ``label``, ``name`` and ``zone``."""
        return {name: getattr(self, name) for name in NUMBERS}

    @property
    def outside(self) -> Array:
        """(n,) the share that leaves the scene: of the sky and of the ground."""
        return self.sky if self.ground is None else self.sky + self.ground

    def gather(self, values: ArrayLike, sky: ArrayLike = 0.0) -> Array:
        """F values: the mean over what each patch sees, (n,) or (n, c); ``sky`` is the value of what is outside of the
        scene, sky and ground."""
        x = np.asarray(values, dtype=np.float64)
        if x.ndim not in (1, 2) or len(x) != len(self):
            raise RadiosityError(f"values have one row for each of {len(self)} patches, not shape {x.shape}")
        light = self.outside if x.ndim == 1 else self.outside[:, None]
        return self.matrix @ x + light * np.asarray(sky)

    def row_sums(self) -> Array:
        """(n,) row sums including the sky and the ground; 1 minus ``dark``, up to the error: 1 in a closed scene."""
        return np.asarray(self.matrix.sum(axis=1)).ravel() + self.outside

    def row_errors(self) -> Array:
        """(n,) root of the summed squares of the standard errors of a row. The standard error of ``F values``, such as
        an irradiance, is at most this times the largest value."""
        return np.sqrt(np.asarray((self.errors**2).sum(axis=1)).ravel())

    def reciprocity_error(self) -> float:
        """Largest ``|A_i F_ij - A_j F_ji|``, in units of the largest ``A_i F_ij``."""
        exchange = self._exchange()
        largest = exchange.max() if exchange.nnz else 0.0
        return float(abs(exchange - exchange.T).max() / largest) if largest else 0.0

    def normalised(self) -> FormFactors:
        """Form factors with every row sum 1, together with the share on backs of faces: each row is divided by its
        sum."""
        sums = self.row_sums() + self.dark
        scale = np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > 0)
        matrix, errors = (_diagonal(scale) @ entries for entries in (self.matrix, self.errors))
        return replace(self, matrix=matrix, errors=errors, **self._scaled_ends(scale))

    def reciprocal(self) -> FormFactors:
        """Form factors with ``A_i F_ij = A_j F_ji``: the mean of both, weighted by the lines per area of the patches as
        in the estimator ``pooled``, so that the one with less noise counts more. The error is the mean of both errors,
        as if they had the same lines. Row sums change."""
        density = np.asarray(self.lines, dtype=np.float64) * inverse(self.areas)
        # Exact factors have no lines; if only some rows have lines, the others hardly count.
        density = np.maximum(density, 1e-12 * density.max()) if density.any() else np.ones(len(density))
        exchange, errors = (_diagonal(density * self.areas) @ x for x in (self.matrix, self.errors))
        mean = (exchange + exchange.T).tocoo()
        noise = entries_of((errors + errors.T).tocsr(), mean.row, mean.col)
        scale = self.areas[mean.row] * (density[mean.row] + density[mean.col])
        matrix, errors = (
            sparse().coo_array((data / scale, mean.coords), shape=mean.shape).tocsr() for data in (mean.data, noise)
        )
        return replace(self, matrix=matrix, errors=errors)

    def truncated(self, threshold: float, *, pairs: bool = False) -> FormFactors:
        """Form factors without those below ``threshold``. pairs: a factor stays if the one of the opposite direction,
        ``A_i F_ij / A_j``, is not below it, so that reciprocal factors remain reciprocal. Row sums become smaller."""
        entries = self.matrix.tocoo()
        larger = entries.data
        if pairs:
            larger = larger * np.maximum(1, self.areas[entries.row] / self.areas[entries.col])
        kept = larger >= threshold
        row, column, n = entries.row[kept], entries.col[kept], len(self)
        matrix, errors = (
            sparse().coo_array((data, (row, column)), shape=(n, n)).tocsr()
            for data in (entries.data[kept], entries_of(self.errors, row, column))
        )
        return replace(self, matrix=matrix, errors=errors)

    def repaired(self) -> FormFactors:
        """Form factors with every row sum 1, together with the share on backs of faces, and ``A_i F_ij = A_j F_ji``, by
        the smallest change.

        The mean of ``A_i F_ij`` and ``A_j F_ji`` (:meth:`reciprocal`), the shares of the sky and of backs are changed
        with the smallest relative sum of squares, so that zeros remain zero. Errors stay those of the mean. Rows
        without entries stay as they are. Raises :class:`RadiosityError` if a factor would become negative, which means
        that there are too few lines, and if no factors with these zeros have both properties.
        """
        from scipy.sparse.linalg import lsmr

        mean = self.reciprocal()
        exchange = mean._exchange()
        sums = np.asarray(exchange.sum(axis=1)).ravel()
        ends = self.areas * (self.outside + self.dark)
        # The smallest changes have the form S_ij (x_i + x_j) for pairs, and S_i x_i for the sky and for backs, which
        # belong to one row. Row sums then require (diag(all sums) + S) x = missing.
        missing, system = self.areas - sums - ends, _diagonal(sums + ends) + exchange
        x = lsmr(system, missing, atol=1e-14, btol=1e-14, maxiter=20 * len(self))[0]
        left = np.where(sums + ends > 0, np.abs(missing - system @ x) * inverse(self.areas), 0.0)
        if left.max(initial=0.0) > _INEXACT:
            raise RadiosityError(
                f"row sums and reciprocity cannot both be exact: the row of patch {left.argmax()} stays off by "
                f"{left.max():.2g}, as what it sees is filled otherwise; cast more lines, or ask for one of both"
            )
        changed = mean.matrix.tocoo()
        factor = 1 + x[changed.row] + x[changed.col]
        if (factor < 0).any() or ((1 + x < 0) & (ends > 0)).any():
            raise RadiosityError("these form factors are too noisy to be repaired: cast more lines")
        changed.data = changed.data * factor
        return replace(mean, matrix=changed.tocsr(), **self._scaled_ends(1 + x))

    def transposed(self) -> FormFactors:
        """Form factors of the opposite direction: A_j F_ji / A_i in place of F_ij. Radiosities that solve the system
        with these factors are the powers per area that solve the system of powers (shooting) with F."""
        areas, per_area = _diagonal(self.areas), _diagonal(inverse(self.areas))
        shot, errors = ((per_area @ x.T.tocsr() @ areas).tocsr() for x in (self.matrix, self.errors))
        return replace(self, matrix=shot, errors=errors)

    @property
    def exchange_weights(self) -> Array | None:
        """(n,) weights, the areas or the lines, with weight_i F_ij = weight_j F_ji; ``None`` if neither make the
        exchange symmetric."""
        for weights in (self.areas, self.lines.astype(np.float64)):
            exchange = _diagonal(weights) @ self.matrix
            if weights.any() and (exchange.nnz == 0 or abs(exchange - exchange.T).max() <= 1e-9 * exchange.max()):
                return weights
        return None

    @property
    def ends(self) -> dict[str, Array]:
        """The shares (n,) or (n, p) of what is no patch, by name: ``sky``, ``dark``, and if known ``ground`` and
        ``sky_patches``."""
        named = {name: getattr(self, name) for name in ("sky", "dark", "ground", "sky_patches")}
        return {name: share for name, share in named.items() if share is not None}

    def _scaled_ends(self, scale: Array) -> dict[str, Any]:
        return {name: (share.T * scale).T for name, share in self.ends.items()}

    def _exchange(self) -> scipy.sparse.csr_array:
        return _diagonal(self.areas) @ self.matrix


def form_factors(
    segments: Segments | Iterable[Pairs],
    estimator: Estimator = "F1",
    *,
    patches: Patches | None = None,
    expected: Array | None = None,
) -> FormFactors:
    """Form factors of segments, see :func:`estimate`.

    Memory is needed for the distinct pairs of patches that see each other; if most pairs have a single segment, as with
    some ten thousand patches, the segments take less memory than the form factors.

    segments: also a stream of chunks, such as ``engine.stream(count)``, which is counted without being stored;
        ``patches`` are then those of the engine, and ``expected``, for the estimator ``reciprocal``, its
        ``expected(count)``.

    Errors are those of independent lines. Raises :class:`RadiosityError` for an unknown estimator, for a stream without
    patches, and if the form factors do not fit into memory.
    """
    check_estimator(estimator)
    stored, chunks = (segments, segments.chunks) if isinstance(segments, Segments) else (None, segments)
    patches = patches if stored is None else stored.patches
    if patches is None:
        raise RadiosityError("a stream of segments does not know its patches: give patches=")
    n = len(patches)
    pairs = PairCounts(n, chunks)
    if stored is None:
        counted: NDArray[np.int64] | Array = pairs.ends[:n, 0]
        to_sky: NDArray[np.int64] | Array = pairs.ends[:n, 1]
        to_dark: NDArray[np.int64] | Array = pairs.ends[:n, 2]
    else:
        counted, to_sky, to_dark, expected = stored.counted, stored.to_sky, stored.to_dark, stored.expected
    lines = expected if estimator == "reciprocal" else counted.astype(np.float64)
    if lines is None:
        raise RadiosityError("the estimator 'reciprocal' divides by the expected lines: give expected=")
    need, free = entry_bytes(estimator) * 2.0 * len(pairs), free_memory()
    if free is not None and need > free:
        raise RadiosityError(
            f"{2 * len(pairs)} form factors of {n} patches need {need / 1e9:.1f} GB; {free / 1e9:.1f} GB are free: "
            "solve on the segments, or cast fewer lines"
        )
    upper = pairs.upper()
    counts = (upper + upper.T).tocsr()
    del pairs, upper
    extra = None if stored is None else stored.extra
    if stored is not None and stored.correction is not None:
        counts = (counts + stored.correction[:n, :n]).tocsr()
    counts.sort_indices()
    matrix = estimate(counts, lines, patches.areas, estimator)
    matrix.sort_indices()  # in the order of the counts
    errors = matrix.copy()
    found = counts.data
    if extra is not None:  # undo the weights: the number of lines and rays together
        row, column = counts.tocoo().coords
        found = found * (1 + extra[row] + extra[column])
    errors.data = matrix.data * np.sqrt(np.maximum(1 - matrix.data, 0) / found)
    sky, dark = shares(to_sky, to_dark, lines)
    return FormFactors(matrix, errors, sky, patches.areas, counted, dark, **numbers_of(patches))


def shares(to_sky: NDArray[Any], to_dark: NDArray[Any], lines: Array) -> tuple[Array, Array]:
    """(n,) shares of the ``lines`` through each patch that lead to the sky, and to backs of faces."""
    sky, dark = (np.divide(ends, lines, out=np.zeros(len(lines)), where=lines > 0) for ends in (to_sky, to_dark))
    return sky, dark


def numbers_of(patches: Patches) -> dict[str, Any]:
    """``face``, ``label`` and ``name`` of form factors, and ``zone`` if there are zones."""
    known = {"face": patches.face, "label": patches.labels, "name": patches.names}
    return known if patches.zones is None else known | {"zone": patches.zones}


def estimate(
    counts: scipy.sparse.csr_array, lines: Array, areas: Array, estimator: Estimator
) -> scipy.sparse.csr_array:
    """Form factors from ``counts`` r_ij of lines that lead from i to j, and ``lines`` r_i through each patch
    [Castro 2002, sec. 4.2.4].

    ==============  =========================================  =====================================================
    ``F1``          ``r_ij / r_i``                             rows sum to 1 in a closed scene, to rounding
    ``F2``          ``(A_j / A_i) r_ji / r_j``                 the estimate of the other patch, by reciprocity
    ``F3``          mean of both, weighted by ``r_i, r_j``
    ``F4``          mean of both, weighted by ``r_ij, r_ji``   the least error
    ``reciprocal``  ``r_ij / r_i``, ``r_i`` as expected        ``A_i F_ij = A_j F_ji`` to rounding
    ``pooled``      ``2 r_ij / (r_i + r_j A_i / A_j)``         the same, with the counted lines of both patches
    ==============  =========================================  =====================================================
    """
    check_estimator(estimator)
    per_line = inverse(lines)
    own = _diagonal(per_line) @ counts
    if estimator in ("F1", "reciprocal"):
        return own.tocsr()
    if estimator == "pooled":
        result = counts.tocoo()
        density = lines * inverse(areas)
        result.data = 2 * result.data / (areas[result.row] * (density[result.row] + density[result.col]))
        return result.tocsr()
    transposed = counts.T.tocsr()
    other = _diagonal(inverse(areas)) @ transposed @ _diagonal(areas * per_line)
    if estimator == "F2":
        return other.tocsr()
    if estimator == "F3":
        result = (_diagonal(lines) @ own + other @ _diagonal(lines)).tocoo()
        result.data = result.data / (lines[result.row] + lines[result.col])
        return result.tocsr()
    weights = (counts + transposed).tocsr()
    weights.data = 1 / weights.data
    return ((counts * own + transposed * other) * weights).tocsr()


def entry_bytes(estimator: str) -> float:
    """Bytes of a form factor while it is computed (measured: 66 to 74, and 131 with both directions)."""
    return 140.0 if estimator in ("F2", "F3", "F4") else 76.0


def check_estimator(estimator: str) -> None:
    """Raise :class:`RadiosityError` for the name of no estimator."""
    if estimator not in ESTIMATORS:
        raise RadiosityError(f"there is no estimator {estimator!r} of form factors; there are: {', '.join(ESTIMATORS)}")


def pair_errors(estimated: FormFactors, exact: FormFactors) -> float:
    """Sum over all pairs of the squared differences, the measure FFE [Castro 2002, sec. 4.3]."""
    return float(((estimated.matrix - exact.matrix) ** 2).sum())


def entries_of(matrix: scipy.sparse.csr_array, rows: NDArray[Any], columns: NDArray[Any]) -> Array:
    """The entries of a matrix at the given rows and columns, 0 where it has none."""
    own, width = matrix.tocoo(), matrix.shape[1]
    keys, wanted = own.row.astype(np.int64) * width + own.col, rows.astype(np.int64) * width + columns
    if not len(keys):
        return np.zeros(len(wanted))
    order = np.argsort(keys)
    found = order[np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)]
    return np.where(keys[found] == wanted, own.data[found], 0.0)


def inverse(values: Array) -> Array:
    """Inverse values, zero for zeros."""
    return np.divide(1.0, values, out=np.zeros(len(values)), where=np.asarray(values) > 0)


def _diagonal(values: Array) -> scipy.sparse.dia_array:
    return sparse().diags_array(values).tocsr()
