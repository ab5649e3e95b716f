r"""Restores what a denoiser has removed besides noise, by the variance of the pixels.

A network smooths details that it takes for noise, and makes whole surfaces a little brighter or darker. This error
exceeds the noise of the raw picture, whose mean over many pixels is hardly noisy. The residual r = raw - clean is
divided into bands by Gaussians of growing width. The energy n of noise in a band is known if pixels are independent:
the variance times the squared norm of the band's kernel. A band whose energy E around a pixel is larger holds lost
details, and is added to the clean picture with the weight :math:`\max(0, 1 - c n / E)` of Wiener's filter. Means over
the widest Gaussian are added in the same way.

c is above 1 for bands, because E scatters around its mean in small windows, and below 1 for means, which have little
noise. In the finest band E counts only pixels whose neighbours have more energy than c n, because the variance of
single pixels is uncertain after few passes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .filters import Frame, packets, unpacked
from .pictures import Picture

#: Standard deviations of the Gaussians between the bands, in pixels, and their radii in standard deviations.
_SIGMAS, _RADIUS = (1.0, 2.0, 4.0, 8.0, 12.0), 2.5
#: c of the bands, and of the means over the widest Gaussian.
_BANDS, _MEANS = 2.5, 0.3
#: Variance of a pixel that is left out, relative to the mean around it.
_FIREFLY = 300.0
#: Standard deviation of the Gaussian that weights the neighbours of a pixel, in pixels.
_NEAR = 2.0
#: Constant added to a clean picture, relative to its mean, before residuals are divided by the picture.
_FLOOR = 0.01


def restored(clean: Picture, raw: Picture, variance: Picture) -> Picture:
    """The picture ``clean`` (height, width, 3), plus the differences from ``raw`` that exceed noise.

    ``variance``: of the pixels of ``raw``, whose errors are assumed to be independent of each other. Otherwise, as with
    ``reconstruction=neighbours``, more noise comes back.
    """
    frame = Frame(clean.shape[1], clean.shape[0])
    level = float(clean.mean())
    if level <= 0.0:
        return clean
    scale = np.maximum(clean, 0.0) + np.float32(_FLOOR * level)  # the noise of light grows with the light
    residual = (raw - clean) / scale
    noise = (np.maximum(variance, 0.0) / np.square(scale)).mean(axis=2, keepdims=True)
    # A firefly has most of the noise around it, and would come back as a blotch.
    finite = np.where(np.isfinite(noise), noise, 0.0)
    usual = noise <= _FIREFLY * _blurred(frame, np.repeat(finite, 3, axis=2), _SIGMAS[-1])[:, :, :1]
    residual, noise = np.where(usual, residual, 0.0), np.where(usual, noise, 0.0)
    gain = np.maximum(clean, 0.0)  # black pixels stay black
    result, narrow, kernel = clean.copy(), residual, np.ones(1)
    for sigma in _SIGMAS:
        wide, wider = _blurred(frame, residual, sigma), _gaussian(sigma)
        band = narrow - wide
        result += gain * band * _weight(frame, band, noise, _BANDS * _norm(kernel, wider), sigma)
        narrow, kernel = wide, wider
    # The rest are means over the widest Gaussian.
    result += gain * narrow * _weight(frame, narrow, noise, _MEANS * _norm(kernel, np.zeros(1)), _SIGMAS[-1])
    return np.asarray(result, np.float32)


def _weight(frame: Frame, band: Picture, noise: Picture, factor: float, sigma: float) -> Picture:
    """Weight of a band, by its energy and the energy of noise around each pixel; ``factor`` multiplies the variance."""
    energy = np.square(band).mean(axis=2, keepdims=True)
    if sigma == _SIGMAS[0]:  # if noise explains the neighbours of a pixel, it explains the pixel
        near, own = _blurred(frame, np.concatenate([energy, noise, noise], axis=2), _NEAR), _gaussian(_NEAR).max() ** 2
        others = near[:, :, :2] - np.float32(own) * np.concatenate([energy, noise], axis=2)
        energy = np.where(others[:, :, :1] > factor * others[:, :, 1:], energy, np.float32(0.0))
    around = _blurred(frame, np.concatenate([energy, noise, noise], axis=2), sigma)
    return np.clip(1.0 - np.float32(factor) * around[:, :, 1:2] / np.maximum(around[:, :, :1], 1e-30), 0.0, 1.0)


def _gaussian(sigma: float) -> NDArray[np.float64]:
    radius = round(_RADIUS * sigma)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return np.asarray(weights / weights.sum())


def _norm(narrow: NDArray[np.float64], wide: NDArray[np.float64]) -> float:
    """Squared norm of the difference of two kernels, each the product of one along rows and one along columns."""
    margin = (max(len(narrow), len(wide)) - np.array([len(narrow), len(wide)])) // 2
    a, b = np.pad(narrow, margin[0]), np.pad(wide, margin[1])
    return float((a @ a) ** 2 - 2.0 * (a @ b) ** 2 + (b @ b) ** 2)


def _blurred(frame: Frame, layer: Picture, sigma: float) -> Picture:
    weights = _gaussian(sigma)
    values = [packets(layer)]
    for down in (False, True):
        values = frame.along(down, len(weights) // 2, values, weights=weights)
    return unpacked(values[0], *layer.shape[:2])
