"""Error measures of images, defined once for the whole project.

    relMSE = mean of (x - ref)^2 / (ref^2 + 0.01)

over channels and over the pixels that are finite in both images. Where a few bright paths may dominate relMSE, it is
also given without the worst pixels (``trim``).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import RELATIVE_EPSILON, OptionError

Array = NDArray[np.float64]

#: Luminance of linear sRGB primaries (ITU-R BT.709).
LUMINANCE: Final = (0.2126, 0.7152, 0.0722)


def relative_squared_error(image: ArrayLike, reference: ArrayLike) -> Array:
    """``(x - ref)^2 / (ref^2 + 0.01)`` per pixel, mean over its channels: shape (height, width).

    NaN where a pixel is not finite in one of the images. Raises :class:`OptionError` if the sizes differ.
    """
    x, ref = _pair(image, reference)
    with np.errstate(invalid="ignore", over="ignore"):
        error = ((x - ref) ** 2 / (ref * ref + RELATIVE_EPSILON)).mean(axis=2)
    error[~_finite(x, ref)] = np.nan
    return error


def relative_mse(image: ArrayLike, reference: ArrayLike, trim: float = 0.0) -> float:
    """relMSE of ``image`` against ``reference``, both (height, width, channels) or (height, width).

    Pixels that are not finite in one of them are left out, and of the rest the fraction ``trim`` with the largest
    error (0.001: the worst 0.1 %). NaN if nothing remains. Raises :class:`OptionError` if the sizes differ or ``trim``
    is outside [0, 1).
    """
    error = relative_squared_error(image, reference)
    return _trimmed_mean(error[np.isfinite(error)], trim)


def luminance_rmse(image: ArrayLike, reference: ArrayLike, trim: float = 0.0) -> float:
    """Root of the mean squared difference of luminance over finite pixels of two RGB images, ``trim`` as for
    :func:`relative_mse`. NaN if there are none."""
    x, ref = _pair(image, reference)
    finite = _finite(x, ref)
    difference = (x[finite] - ref[finite]) @ np.array(LUMINANCE)
    return float(np.sqrt(_trimmed_mean(difference**2, trim)))


def relative_bias(image: ArrayLike, reference: ArrayLike) -> float:
    """``mean(image) / mean(reference) - 1`` over channels and finite pixels: too bright is positive.

    For an unbiased estimator this is noise around 0. NaN if no pixel is finite or the reference is black.
    """
    x, ref = _pair(image, reference)
    finite = _finite(x, ref)
    total = ref[finite].sum()
    return float(x[finite].sum() / total - 1.0) if total > 0.0 else float("nan")


def block_average(image: ArrayLike, factor: int) -> Array:
    """Mean of each ``factor`` x ``factor`` block: (height, width, channels) to (height / factor, width / factor, ...).

    A block that holds a non-finite pixel is not finite, and the error measures leave it out. Raises
    :class:`OptionError` if the factor does not divide the size.
    """
    x = np.asarray(image, dtype=np.float64)
    height, width = x.shape[:2]
    if factor < 1 or height % factor or width % factor:
        raise OptionError(f"an image of {width} x {height} pixels cannot be averaged in blocks of {factor}")
    with np.errstate(invalid="ignore"):
        return x.reshape(height // factor, factor, width // factor, factor, *x.shape[2:]).mean(axis=(1, 3))


def _trimmed_mean(error: Array, trim: float) -> float:
    """Mean without the largest ``trim`` of the values; NaN if nothing remains."""
    if not 0.0 <= trim < 1.0:
        raise OptionError(f"trim is a fraction of the pixels in [0, 1), not {trim}")
    kept = np.sort(error)[: len(error) - int(np.floor(trim * len(error)))]
    return float(kept.mean()) if len(kept) else float("nan")


def _pair(image: ArrayLike, reference: ArrayLike) -> tuple[Array, Array]:
    x, ref = (np.asarray(a, dtype=np.float64) for a in (image, reference))
    x, ref = (a[:, :, None] if a.ndim == 2 else a for a in (x, ref))
    if x.shape != ref.shape:
        raise OptionError(
            f"the picture is {_size(x)} and the reference {_size(ref)}; render with the reference's size, "
            "or average the larger one in blocks"
        )
    return x, ref


def _size(x: Array) -> str:
    return " x ".join(str(n) for n in (x.shape[1], x.shape[0], *x.shape[2:])) if x.ndim > 1 else f"{x.shape}"


def _finite(x: Array, ref: Array) -> NDArray[np.bool_]:
    return np.asarray((np.isfinite(x) & np.isfinite(ref)).all(axis=2))
