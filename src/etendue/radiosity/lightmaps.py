"""Lightmaps of a solution."""

from __future__ import annotations

from typing import Literal

import numpy as np

from etendue.surfaces import Lightmap, PatchSurfaces, SurfaceValues, TexturedMesh, lightmap_of

from .errors import RadiosityError
from .solvers.system import Solution
from .solvers.values import check_colours, radiosity_on


def lightmap(
    solution: Solution,
    mesh: TexturedMesh,
    size: tuple[int, int],
    *,
    quantity: Literal["radiosity", "irradiance"] = "radiosity",
    smooth: bool = True,
    angle: float = 30.0,
) -> Lightmap:
    """A texture of (width, height) ``size`` with the radiosity, or the irradiance, of the surfaces of the mesh.

    Texels are filled as in :func:`lightmap_of`. Renderers multiply an irradiance by the colour of the surface, so the
    textures of surfaces stay sharp.

    Raises :class:`RadiosityError` unless there are one or three channels, and :class:`SurfaceError` if triangles
    overlap in the texture or leave the unit square, or if no patches lie on the mesh.
    """
    check_colours(solution)
    if quantity not in ("radiosity", "irradiance"):
        raise RadiosityError(f"a lightmap is of 'radiosity' or 'irradiance', not {quantity!r}")
    surfaces = PatchSurfaces(solution.patches)
    if quantity == "radiosity":
        values = radiosity_on(surfaces, solution, smooth=smooth, angle=angle)
    elif smooth:
        n = len(solution.patches)
        values = SurfaceValues(surfaces, np.zeros((n, 1)), np.ones((n, 1)), solution.irradiance, angle)
    else:
        values = SurfaceValues(surfaces, solution.irradiance)
    return lightmap_of(surfaces, values, mesh, size)
