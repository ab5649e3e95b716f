"""Distribution of lines over the spheres of a tree: shares, and whole numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from ..errors import RadiosityError
from .tree import SphereTree

#: Share of the lines that is cast in the main sphere [Castro 2002, sec. 4.2.3].
MAIN_SHARE = 0.2
#: Steps to the shares of least error; fifty come within 1 %.
_STEPS = 200


def area_shares(tree: SphereTree, main: float = MAIN_SHARE) -> Array:
    """(m,) shares of the lines: ``main`` in the main sphere, the rest by the probability that a line of a sphere hits
    something, roughly the area of its objects over that of the sphere [Castro 2002, sec. 4.2.3].

    Raises :class:`RadiosityError` for a share ``main`` that is not above 0 and at most 1: walls need the main sphere.
    """
    if not 0 < main <= 1:
        raise RadiosityError(f"the main sphere has a share of the lines above 0 and up to 1, not {main!r}")
    weights = tree.areas / tree.surfaces
    weights[0] = 0.0
    return np.concatenate([[main], (1 - main) * weights[1:] / weights.sum()])


def least_error_shares(tree: SphereTree) -> Array:
    """(m,) shares that minimise the squared errors of form factors (F1) for a given number of lines.

    The variance of row i is at most 1 / r_i, and r_i = A_i sum_S 2 n_S / S over the spheres that patch i belongs to:
    the sum over i is convex in the shares. Each step multiplies a share by the root of the decrease of this sum per
    additional line in the sphere; such a step never increases the sum [Silvey 1978].
    """
    patches = tree.objects.patches
    shares = area_shares(tree)
    for _ in range(_STEPS):
        density = tree.of_patches(tree.densities(shares))
        gain = tree.summed(~patches.empty / (patches.divisors * density**2)) / tree.surfaces
        shares = shares * np.sqrt(gain)
        shares /= shares.sum()
    return shares


def allocated(lines: int, shares: Array) -> NDArray[np.int64]:
    """(m,) whole numbers that sum to ``lines``, by ``shares`` (m,), which sum to 1: rounded up where the remainders are
    largest, and down elsewhere."""
    exact = lines * shares
    counts = np.floor(exact).astype(np.int64)
    rest = lines - int(counts.sum())
    counts[np.argsort(counts - exact, kind="stable")[:rest]] += 1
    return counts
