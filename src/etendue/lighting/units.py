"""Photometric units."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array
from etendue.film import LUMINANCE

from .errors import LightingError

#: Luminous efficacy of light whose RGB values are radiometric, in lm/W: luminance in cd/m^2 is this times the luminance
#: of the picture, illuminance in lux this times the luminance of irradiance. It is that of monochromatic light at 540
#: THz; programs with another convention (Radiance: 179) differ by a factor in their files, not in their results.
EFFICACY = 683.0


def photometric(values: ArrayLike) -> Array:
    """(...) illuminance in lx of irradiance (..., c), luminance in cd/m^2 of radiance, or luminous exitance in lm/m^2
    of radiosity, in linear RGB (c = 3) or of grey light (c = 1).

    Raises :class:`LightingError` for another number of channels, whose luminance is not known.
    """
    rgb = np.asarray(values, dtype=np.float64)
    if rgb.ndim < 1 or rgb.shape[-1] not in (1, 3):
        raise LightingError(f"photometric values are of one channel or three, not of an array of shape {rgb.shape}")
    result: Array = EFFICACY * (rgb[..., 0] if rgb.shape[-1] == 1 else rgb @ np.array(LUMINANCE))
    return result
