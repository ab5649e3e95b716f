"""Pictures of a number of each patch: in false colours, from outside through the backs of walls."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import OptionError
from etendue.display import MeshView, false_colour_picture
from etendue.surfaces import Patches

from .pages.meshviews import on_pixels, seen_patches

#: Direction of the view, and width and height of the picture without its legend: of that height it is not enlarged.
_DIRECTION, _SIZE = (-0.5, 0.75, -0.7), (600, 400)


def patch_picture(
    patches: Patches, values: ArrayLike, unit: str, low: float | None = None, high: float | None = None
) -> NDArray[Any]:
    """Sight of patches with z up from above their front, as sRGB bytes (h, w, 3) for ``etendue.display.write_png``.

    values: (n,), not negative; NaN, of what has no value, is turquoise. unit: of the legend. low, high: the ends of the
    linear scale, by default the least and the largest value. Where no front of a face is seen it is white. Raises
    :class:`OptionError` for another number of values.
    """
    shown = np.asarray(values, dtype=np.float64)
    if shown.shape != (len(patches),):
        raise OptionError(f"a picture shows one value for each of {len(patches)} patches, not {shown.shape}")
    low = float(np.nanmin(shown)) if low is None else low
    high = float(np.nanmax(shown)) if high is None else high
    high = high if high > low else low + 1.0  # all alike
    view = MeshView.around("from above", patches.vertices, _DIRECTION, (0, 0, 1), _SIZE[0] / _SIZE[1])
    seen = seen_patches(patches, view, _SIZE)
    made = np.array(false_colour_picture(on_pixels(shown, seen, outside=low), unit, low, high, logarithmic=False))
    made[: _SIZE[1], : _SIZE[0]][seen < 0] = 255
    return made
