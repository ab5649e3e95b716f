"""Form factors with exact row sums, exact reciprocity and without small entries, and what that changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.core import Array, OptionError, logger

from .formfactors import FormFactors, entries_of, inverse

#: A change is a fault of the factors above this multiple of the standard error and rounding, or, if no error is known,
#: above a thousandth, as programs that read view factors accept it.
_ERRORS, _ROUNDING, _UNKNOWN = 5.0, 1e-5, 1e-3


@dataclass(frozen=True)
class Correction:
    """Corrected form factors, and how they differ from those before.

    ``off``, ``left``: the largest deviation of a row sum, with the shares of the sky and of backs, from 1, before and
    after. ``largest``, ``rms``: change of the factors that are left, these shares included. ``off_in_errors``,
    ``largest_in_errors``, ``rms_in_errors``: the same in standard errors, those of independent lines; ``None`` if no
    error is known, as of exact factors. ``dropped``: the number of factors below the threshold; ``dropped_share``: the
    largest sum of these in a row. ``is_sound``: whether standard errors and the threshold explain all changes.
    """

    factors: FormFactors
    off: float
    left: float
    largest: float
    rms: float
    off_in_errors: float | None
    largest_in_errors: float | None
    rms_in_errors: float | None
    dropped: int
    dropped_share: float
    is_sound: bool

    def __str__(self) -> str:
        """One line."""
        values = (self.off, self.off_in_errors), (self.largest, self.largest_in_errors), (self.rms, self.rms_in_errors)
        off, largest, rms = (f"{x:.2g}" if e is None else f"{x:.2g} ({e:.2g} standard errors)" for x, e in values)
        words = f"row sums were off by at most {off} and are by {self.left:.2g}; factors change by at most {largest}, "
        words += f"rms {rms}"
        if self.largest_in_errors is None:
            words += "; their standard errors are not known"
        if self.dropped:
            words += f"; {self.dropped} small ones dropped, at most {self.dropped_share:.2g} of a row"
        return words


def check_threshold(threshold: float) -> None:
    """Raise :class:`OptionError` unless ``threshold`` is at least 0 and below 1."""
    if not 0 <= threshold < 1:
        raise OptionError(f"the threshold of form factors is at least 0 and below 1, not {threshold!r}")


def corrected(
    factors: FormFactors, *, row_sums: bool = False, reciprocal: bool = False, threshold: float = 0.0
) -> Correction:
    """Correct form factors, and compare the changes with the standard errors.

    row_sums: every row sums to 1, with the shares of the sky and of backs. reciprocal: ``A_i F_ij = A_j F_ji``. Both
    together are :meth:`FormFactors.repaired`, the smallest relative change. threshold: smaller factors are dropped
    before, with ``reciprocal`` those that are smaller in both directions; ``row_sums`` returns their share to the other
    entries of the row, otherwise it is missing.

    A change of more than five standard errors, or of a thousandth where no error is known, such as that of rows that
    sum to 1.09, is a fault of the factors that the correction would hide: a warning tells it. Rows without entries
    cannot be corrected: a warning names the first. Raises :class:`OptionError` for a threshold outside [0, 1), and the
    errors of :meth:`FormFactors.repaired`.
    """
    check_threshold(threshold)
    both = factors.reciprocal() if reciprocal else factors
    made = both.truncated(threshold, pairs=reciprocal) if threshold > 0 else both
    dropped = np.asarray((both.matrix - made.matrix).sum(axis=1)).ravel()
    count = int(both.matrix.nnz - made.matrix.nnz)
    if row_sums:
        made = made.repaired() if reciprocal else made.normalised()
        _warn_of_empty_rows(made)
    sums, after = (x.row_sums() + x.dark for x in (factors, made))
    off, left = (np.where(sums > 0, np.abs(x - 1), 0.0) for x in (sums, after))
    # The sum is that of all lines through a patch, whose number has the variance of a count.
    off_errors = np.sqrt(inverse(np.asarray(factors.lines, dtype=np.float64)))
    changes, errors, asked = _changes(factors, made, off_errors, dropped)
    wrong, beyond = off - _allowed(off_errors), changes - _allowed(errors) - asked
    fault = ""
    if row_sums and wrong.max(initial=0.0) > 0:
        fault = f"the row of patch {wrong.argmax()} is off by {off[wrong.argmax()]:.2g}"
    elif beyond.max(initial=0.0) > 0:
        fault = f"a form factor changes by {changes[beyond.argmax()]:.2g}"
    if fault:
        logger.warning(
            "%s, more than standard errors explain: a correction hides this and does not mend it; cast more bundles, "
            "or look for faces that are turned the wrong way or lie on each other (etendue.radiosity.diagnose)",
            fault,
        )
    ratios, row_ratios = _in_errors(changes, errors), _in_errors(off, off_errors)
    return Correction(
        factors=made,
        off=float(off.max(initial=0.0)),
        left=float(left.max(initial=0.0)),
        largest=float(changes.max(initial=0.0)),
        rms=_rms(changes),
        off_in_errors=float(row_ratios.max()) if len(row_ratios) else None,
        largest_in_errors=float(ratios.max()) if len(ratios) else None,
        rms_in_errors=_rms(ratios) if len(ratios) else None,
        dropped=count,
        dropped_share=float(dropped.max(initial=0.0)),
        is_sound=not fault,
    )


def _allowed(errors: Array) -> Array:
    """Changes that the standard errors explain."""
    return np.where(errors > 0, _ERRORS * errors + _ROUNDING, _UNKNOWN)


def _changes(before: FormFactors, after: FormFactors, row_errors: Array, dropped: Array) -> tuple[Array, Array, Array]:
    """Changes of the factors that are left and of the shares of the sky and of backs, their standard errors, 0 if not
    known, and changes that a threshold may cause, which ``dropped`` these shares of rows.

    ``row_errors``: relative ones of the number of lines; a factor F has that of a count, sqrt(F) times as large, also
    where no line has found it."""
    entries = after.matrix.tocoo()
    was, error = (entries_of(x, entries.row, entries.col) for x in (before.matrix, before.errors))
    counted = np.sqrt(np.maximum(was, entries.data)) * row_errors[entries.row]
    changes, errors = [entries.data - was], [np.maximum(error, counted)]
    asked = [dropped[entries.row] + dropped[entries.col]]
    for share, now in ((before.outside, after.outside), (before.dark, after.dark)):
        rows = np.flatnonzero(share)
        changes.append((now - share)[rows])
        errors.append(np.sqrt(share[rows]) * row_errors[rows])
        asked.append(dropped[rows])
    return np.abs(np.concatenate(changes)), np.concatenate(errors), np.concatenate(asked)


def _in_errors(values: Array, errors: Array) -> Array:
    """``values`` in standard errors, where these are known."""
    known = errors > 0
    return np.asarray(values[known] / errors[known])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _warn_of_empty_rows(factors: FormFactors) -> None:
    empty = np.flatnonzero((factors.row_sums() + factors.dark == 0) & (factors.areas > 0))
    if len(empty):
        logger.warning(
            "%d rows are empty and cannot sum to 1, the first is that of patch %d: cast more lines, or lower the "
            "threshold",
            *(len(empty), empty[0]),
        )
