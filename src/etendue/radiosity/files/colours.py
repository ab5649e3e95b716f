"""Solutions as vertex colours of glTF."""

from __future__ import annotations

from etendue.formats import GltfMesh
from etendue.surfaces import VertexRadiosity, shown_exposure, vertex_colours

from ..solvers.system import Solution


def coloured_mesh(solution: Solution, smooth: VertexRadiosity, exposure: float | None = None) -> GltfMesh:
    """Interpolated radiosities as colours, see :func:`etendue.surfaces.vertex_colours`.

    The default exposure keeps 99 % of the non-emitting area below 1. The attribute ``_RADIOSITY`` is not clipped.
    """
    if exposure is None:
        patches, radiosity = solution.patches, solution.radiosity
        reflects = ~patches.emission.any(axis=1) & (radiosity.max(axis=1) > 0)
        chosen = reflects if reflects.any() else radiosity.max(axis=1) > 0
        exposure = shown_exposure(radiosity[chosen], patches.areas[chosen]) if chosen.any() else 1.0
    return vertex_colours(smooth, exposure, "_RADIOSITY")
