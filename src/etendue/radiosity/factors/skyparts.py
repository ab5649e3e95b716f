"""Form factors of the parts of what is outside of a scene: the ground, the sky, and the sky's patches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, logger
from etendue.lighting import SkyPatches, compass

from ..errors import RadiosityError, check_up
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
    check_up(segments.patches, up)
    patches = None if m is None else SkyPatches(m)
    shares = sky_shares(segments, compass(up, north), patches)
    met = segments.directions_met(*_parts(compass(up, north), patches))
    if unmet := int(np.count_nonzero(met == 0)):
        logger.warning("no line goes to %d of %d patches of the sky: cast more bundles", unmet, len(met) - 1)
    # The estimator may have divided by other numbers of lines.
    shares *= (factors.sky * inverse(segments.sky))[:, None]
    by_patch = shares[:, 1:]
    return replace(
        factors,
        ground=shares[:, 0],
        sky=by_patch.sum(axis=1),
        sky_patches=None if patches is None else by_patch,
    )


def sky_shares(segments: Segments, frame: Array, patches: SkyPatches | None = None) -> Array:
    """(n, p) shares of the segments of each patch that lead to the ground and to the patches of the sky, if these are
    ``None`` to the whole of it. ``frame``: see :func:`etendue.lighting.compass`. Errors as :func:`sky_parts`."""
    part, count = _parts(frame, patches)
    need, free = 32.0 * len(segments.patches) * count, free_memory()
    if free is not None and need > free:
        raise RadiosityError(
            f"the shares of {count} patches of the sky need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: divide "
            "the sky into fewer"
        )
    angles = np.array([2 * np.pi] * 2) if patches is None else patches.solid_angles
    counts = segments.sky_counts(part, angles / angles.sum())
    ground = counts[:, 0] * inverse(segments.exchange_weights)
    sky = np.maximum(segments.sky - ground, 0.0) * inverse(counts[:, 1:].sum(axis=1))
    return np.column_stack([ground, counts[:, 1:] * sky[:, None]])


def _parts(frame: Array, patches: SkyPatches | None) -> tuple[Callable[[Array], NDArray[np.int64]], int]:
    """The part of each direction (k, 3), 0 for the ground, and the number of parts."""

    def part(directions: Array) -> NDArray[np.int64]:
        own = directions @ frame.T
        return (own[:, 2] > 0).astype(np.int64) if patches is None else patches.number_of(own)

    return part, 2 if patches is None else patches.count
