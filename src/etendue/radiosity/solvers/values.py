"""A solution as a function on its surfaces, for pictures and lightmaps."""

from __future__ import annotations

import numpy as np

from etendue.surfaces import PatchSurfaces, SurfaceValues

from ..errors import RadiosityError
from .system import Solution


def radiosity_on(
    surfaces: PatchSurfaces, solution: Solution, *, smooth: bool = True, angle: float = 30.0
) -> SurfaceValues:
    """The radiosity of a solution as a function on its surfaces: emission and reflectance of the patch with an
    interpolated irradiance, or (``smooth=False``) the radiosity of the patch.

    Raises :class:`RadiosityError` unless there are one or three channels.
    """
    check_colours(solution)
    patches = solution.patches
    if not smooth:
        return SurfaceValues(surfaces, solution.radiosity)
    return SurfaceValues(surfaces, patches.emission, patches.reflectance, solution.irradiance, angle)


def irradiance_on(
    surfaces: PatchSurfaces, solution: Solution, *, smooth: bool = True, angle: float = 30.0
) -> SurfaceValues:
    """The irradiance of a solution on its surfaces, interpolated or (``smooth=False``) that of the patch. Errors as
    :func:`radiosity_on`."""
    check_colours(solution)
    if not smooth:
        return SurfaceValues(surfaces, solution.irradiance)
    nothing, whole = np.zeros((len(solution.patches), 1)), np.ones((len(solution.patches), 1))
    return SurfaceValues(surfaces, nothing, whole, solution.irradiance, angle)


def check_colours(solution: Solution) -> None:
    """Raises :class:`RadiosityError` if the channels of a solution are not one or three."""
    if solution.patches.channels not in (1, 3):
        raise RadiosityError(
            f"a picture shows one channel or three, not {solution.patches.channels}; write .vtu or .npz"
        )
