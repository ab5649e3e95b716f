"""Form factors of the parts of what is outside of a scene: the ground, the sky, and the sky's patches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, logger
from etendue.lighting import SkyPatches, compass

from ..errors import RadiosityError
from ..lines.segments import Segments
from .formfactors import FormFactors, inverse


def sky_parts(
    factors: FormFactors, segments: Segments, up: str = "z", north: float = 0.0, m: int | None = None
) -> FormFactors:
    """The same form factors with the ground apart from the sky, and with ``m`` the shares of 144 m^2 + 1 patches of the
    sky.

    What leaves the scene downward is the share of the ground, the rest that of the sky: ``sky + ground`` is what
    ``sky`` was. The lines of a bundle are parallel, so what leaves along a bundle goes to one patch of the sky, and its
    opposite to the ground. The shares of patches sum to that of the sky exactly; they are weighted by the number of
    bundles that each patch of the sky has got, see :meth:`Segments.sky_counts`.

    segments: those of the factors, with directions. up, north: see :func:`etendue.lighting.compass`. Warns of patches
    of the sky that have got no bundle. Raises :class:`RadiosityError` for segments without directions, and if the
    shares do not fit into memory.
    """
    frame, n = compass(up, north), len(factors)
    patches = None if m is None else SkyPatches(m)
    angles = np.array([2 * np.pi] * 2) if patches is None else patches.solid_angles
    need, free = 32.0 * n * len(angles), free_memory()
    if free is not None and need > free:
        raise RadiosityError(
            f"the shares of {len(angles)} patches of the sky need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: "
            "divide the sky into fewer"
        )

    def part(directions: Array) -> NDArray[np.int64]:
        own = directions @ frame.T
        return (own[:, 2] > 0).astype(np.int64) if patches is None else patches.number_of(own)

    counts = segments.sky_counts(part, angles / angles.sum())
    to_ground, to_patches = counts[:, 0], counts[:, 1:]
    ground = factors.sky * to_ground * inverse(np.asarray(segments.to_sky, np.float64))
    shares = to_patches * ((factors.sky - ground) * inverse(to_patches.sum(axis=1)))[:, None]
    if unmet := int(np.count_nonzero(segments.directions_met(part, len(angles)) == 0)):
        logger.warning("no line goes to %d of %d patches of the sky: cast more bundles", unmet, len(angles) - 1)
    return replace(factors, ground=ground, sky=shares.sum(axis=1), sky_patches=None if patches is None else shares)
