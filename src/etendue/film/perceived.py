"""HDR-FLIP [Andersson 2021]: how different two pictures look when a viewer alternates between them, over all exposures;
by ``flip-evaluator`` (extra ``flip``)."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import OptionError, library

_MODULE = "flip_evaluator"


def flip_is_installed() -> bool:
    """Whether the library is installed."""
    return find_spec(_MODULE) is not None


def flip_error(image: ArrayLike, reference: ArrayLike) -> NDArray[np.float32]:
    """Error in [0, 1] of each pixel of ``image`` against ``reference``, both (height, width, 3) linear RGB.

    The error is seen at 67 pixels per degree, a usual viewing distance, and is the largest over the exposures that the
    reference determines. NaN where a pixel is not finite in one of the pictures; for the errors of its neighbours this
    pixel counts as equal to the reference.
    Raises :class:`OptionError` if the sizes differ, :class:`BackendError` if the library is missing.
    """
    x, ref = (np.ascontiguousarray(a, dtype=np.float32) for a in (image, reference))
    if x.shape != ref.shape or x.ndim != 3 or x.shape[2] != 3:
        raise OptionError(f"FLIP compares pictures of one size with three channels, not {x.shape} with {ref.shape}")
    evaluator = library(_MODULE, "the measure FLIP", "flip")
    known = np.asarray((np.isfinite(x) & np.isfinite(ref)).all(axis=2))
    ref = np.where(known[:, :, None], np.maximum(ref, 0.0), 0.0)
    x = np.where(known[:, :, None], np.maximum(x, 0.0), ref)
    if not ref.any():  # no light, from which the library could choose exposures
        error = (x.max(axis=2) > 0.0).astype(np.float32)
    else:
        found, _, _ = evaluator.evaluate(ref, x, "HDR", applyMagma=False, computeMeanError=False)
        error = np.array(found, dtype=np.float32).reshape(x.shape[:2])
    error[~known] = np.nan
    return error


def flip(image: ArrayLike, reference: ArrayLike) -> float:
    """Mean of :func:`flip_error` over the pixels that are finite in both pictures; NaN if there are none."""
    error = flip_error(image, reference)
    finite = np.isfinite(error)
    return float(error[finite].mean(dtype=np.float64)) if finite.any() else float("nan")
