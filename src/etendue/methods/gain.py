r"""Whether a guide pays: error and cost of guided camera paths beside those of paths without it.

Both errors are estimated from guided paths, since paths without a guide may not find within a run what a guide finds.
A guided path that is R times as likely as without the guide, with the value C, has the expectations

.. math:: E[C^2] \quad\text{and}\quad E[C^2 R],

the second moments with and without the guide; :class:`~etendue.transport.GuidedWalk` has the sum over the
contributions of a path, with their products. Less the squared mean they are the variances.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import RELATIVE_EPSILON, Array

#: Most pixels that are looked at; pixels of a group, and the share of the groups, of the largest errors, that is left
#: out.
_PIXELS, _GROUP, _TRIM = 1 << 14, 16, 0.02
#: Time of a ray of a guided path, over that of a ray of a path without a guide.
_COST = 1.35


class Gain:
    """Sums over the camera paths of a generation of a guide.

    Parameters
    ----------
    pixels: of the picture.
    """

    def __init__(self, pixels: int) -> None:
        self._stride = -(-pixels // _PIXELS)
        self._pixels = -(-pixels // self._stride)
        #: Mean number of rays of a path without the guide; 0 before the first generation has ended.
        self._plain_rays = 0.0
        self._clear()

    def _clear(self) -> None:
        self._sums = np.zeros((3, self._pixels))
        self._paths = self._rays = 0.0

    def add(self, light: mi.Float, plain_square: mi.Float, count: int, rays: float) -> None:
        """Add the paths of a lot, ``count`` consecutive ones of each pixel: their luminance, its square without the
        guide, and their mean number of rays."""
        number, each = dr.arange(mi.UInt32, self._pixels * count), dr.opaque(mi.UInt32, count)
        pixel = number // each
        lane = pixel * dr.opaque(mi.UInt32, self._stride) * each + (number - pixel * each)
        light, plain_square = (dr.gather(mi.Float, value, lane) for value in (light, plain_square))
        sums = [dr.block_sum(value, count) for value in (light, dr.square(light), plain_square)]
        dr.eval(sums)
        self._sums = self._sums + np.array([np.array(value, np.float64) for value in sums])
        self._paths += count
        self._rays += count * rays

    def end_generation(self) -> float:
        """Error times cost of the generation's paths, over that of paths without the guide. The first generation has
        no guide."""
        rays = self._rays / self._paths
        self._plain_rays = self._plain_rays or rays
        guided, plain = self._errors()
        self._clear()
        return _COST * rays / self._plain_rays * guided / plain if plain > 0.0 else _COST

    def _errors(self) -> tuple[float, float]:
        """Relative variances with and without the guide: means over groups of pixels."""
        begins = np.arange(0, self._pixels, _GROUP)
        sizes = np.diff(np.append(begins, self._pixels))
        mean, guided, plain = np.add.reduceat(self._sums / self._paths, begins, axis=1) / sizes
        squared: Array = np.add.reduceat(np.square(self._sums[0] / self._paths), begins) / sizes
        scale = np.square(mean) + RELATIVE_EPSILON * np.square(mean.mean())
        if not scale.all():
            return 0.0, 0.0
        errors = np.maximum(np.array([guided - squared, plain - squared]), 0.0) / scale
        kept = np.argsort(errors.sum(axis=0))[: max(1, int((1.0 - _TRIM) * len(scale)))]
        return float(errors[0, kept].mean()), float(errors[1, kept].mean())

    def state(self) -> dict[str, object]:
        """The sums, as arrays that are not modified later."""
        return {"sums": self._sums, "paths": self._paths, "rays": self._rays, "plain_rays": self._plain_rays}

    def restore(self, state: dict[str, object]) -> None:
        """Inverse of :meth:`state`."""
        self._sums = np.asarray(state["sums"], np.float64)
        self._paths, self._rays, self._plain_rays = (float(str(state[k])) for k in ("paths", "rays", "plain_rays"))
