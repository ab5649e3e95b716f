"""Daylight coefficients of patches: what each patch of the sky contributes to their irradiance, directly and by
reflections.

The irradiance of patch i by the ground or a patch s of the sky with radiance 1 is H_is = pi S_is + (F B)_is, with the
share S_is of the lines through i that lead to s, and radiosities B = rho H: one radiosity system with a channel for
each patch of the sky, whose first shot is pi S.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from etendue.core import Array
from etendue.lighting import DaylightCoefficients, Meters, SkyPatches, compass
from etendue.surfaces import Patches

from ..errors import RadiosityError
from ..factors.formfactors import form_factors
from ..factors.skyparts import sky_shares
from ..lines.segments import Segments
from .shot import FirstShot
from .system import Transport, solve

#: Most patches for which the system is solved on form factors, which takes less time; else on segments.
_MOST_FACTORS = 20_000


def daylight_of_patches(
    segments: Segments,
    m: int = 1,
    up: str = "z",
    north: float = 0.0,
    *,
    patches: Patches | None = None,
    metadata: dict[str, Any] | None = None,
) -> DaylightCoefficients:
    """Daylight coefficients of patches for the ground and 144 m^2 + 1 patches of the sky, with all reflections
    [Tregenza 1983].

    segments: with directions, in two batches at least. up, north: see :func:`etendue.lighting.compass`. patches: those
    of the segments, with other reflectances in one or three channels. Their emission and sky have no effect.

    The meters of the result are the centres of the patches with their normals; the values are means over the patches.
    Standard errors are those of the direct light, by leaving out one batch of lines after the other, and of the last
    bounce; of batches of one sequence they are upper estimates. Raises :class:`RadiosityError` for segments without
    directions or batches, another number of channels, and patches that do not see the sky.
    """
    patches = segments.patches if patches is None else patches
    if patches.channels not in (1, 3):
        raise RadiosityError(f"daylight has one channel or three, not {patches.channels}")
    if segments.batch_count < 2:
        raise RadiosityError("daylight coefficients need at least two batches of lines for their errors: cast more")
    sky, frame = SkyPatches(m), compass(up, north)
    direct = np.pi * sky_shares(segments, frame, sky)
    if not direct.any():
        raise RadiosityError("no patch sees the sky: there is no daylight; is the mesh closed?")
    count = segments.batch_count
    squares = np.zeros_like(direct)
    for k in range(count):
        squares += (np.pi * sky_shares(segments.without(k), frame, sky) - direct) ** 2
    error = np.sqrt(squares * (count - 1) / count)
    transport: Transport = form_factors(segments) if len(patches) <= _MOST_FACTORS else segments
    channels = [_with_reflections(patches, c, direct, error, segments, transport) for c in range(patches.channels)]
    values, errors = (np.repeat(np.stack(x, axis=2), 3 // len(channels), axis=2) for x in zip(*channels, strict=True))
    flat = np.linalg.norm(patches.normals, axis=1, keepdims=True) > 0.5
    places = Meters(patches.centres, np.where(flat, patches.normals, compass(up, north)[2]))
    return DaylightCoefficients(places, sky, values, errors, dict(metadata or {}))


def _with_reflections(
    patches: Patches, channel: int, direct: Array, error: Array, segments: Segments, transport: Transport
) -> tuple[Array, Array]:
    """Irradiances (n, p) of a channel of the reflectance, and their errors."""
    dark = np.zeros_like(direct)
    dimmed = patches.with_properties(patches.reflectance[:, channel : channel + 1], dark, 0.0)
    nothing = np.zeros(direct.shape[1])
    shot = FirstShot(dimmed, dark, direct, error, nothing, nothing, 0)
    solution = solve(dimmed, transport, "conjugate-gradient", shot=shot)
    if not patches.reflectance[:, channel].any():
        return direct, error
    return solution.irradiance, solution.irradiance_error(segments)
