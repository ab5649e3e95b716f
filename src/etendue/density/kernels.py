"""Kernels of density estimation in the plane, as factors on the uniform disc: each integrates to pi over the unit disc.

An estimate at x from points x_i of weight w_i is ``sum w_i K(|x_i - x|^2 / r^2) / (pi r^2)``. Smoother kernels trade a
little variance for less bias at the rim of the disc [Silverman 1986, ch. 4].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

#: Name to K(t), t the squared distance over the squared radius, in [0, 1].
KERNELS: dict[str, Callable[[Any], Any]] = {
    "uniform": lambda t: 1.0,
    "cone": lambda t: 3.0 * (1.0 - dr.sqrt(t)),
    "epanechnikov": lambda t: 2.0 * (1.0 - t),
    "biweight": lambda t: 3.0 * dr.square(1.0 - t),
}
