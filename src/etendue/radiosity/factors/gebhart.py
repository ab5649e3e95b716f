"""Gebhart factors: the share of the emission of a patch that another one absorbs, including all reflections."""

from __future__ import annotations

import numpy as np

from etendue.core import Array
from etendue.surfaces import Patches

from ..errors import RadiosityError
from .formfactors import FormFactors


def gebhart_factors(patches: Patches, factors: FormFactors, channel: int = 0) -> Array:
    """G_ij (n, n), the share of the emission of patch i that patch j absorbs, over all reflections [Gebhart 1961].

    G = (1 - F rho)^-1 F epsilon. Rows sum to 1 in a closed scene, and with reciprocal form factors
    epsilon_i A_i G_ij = epsilon_j A_j G_ji. For a few thousand patches. Raises :class:`RadiosityError` if patches and
    form factors differ in number, and for an invalid channel.
    """
    if len(patches) != len(factors):
        raise RadiosityError(f"there are {len(patches)} patches, but form factors of {len(factors)}")
    if not 0 <= channel < patches.channels:
        raise RadiosityError(f"there are the channels 0 to {patches.channels - 1}, not {channel!r}")
    f, rho = np.asarray(factors.matrix.todense()), patches.reflectance[:, channel]
    return np.linalg.solve(np.eye(len(f)) - f * rho, f * (1 - rho)).astype(np.float64)
