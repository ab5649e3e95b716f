"""The hemicube [Cohen 1985], the classical way to form factors, beside local lines and global lines."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, FormFactors, RayScene, form_factors, local_form_factors, pair_errors
from etendue.surfaces import STEP, across

from ..measuring import Record, timed
from ..options import whole_numbers
from .options import BUNDLES, Detail, ReferenceBundles, Scenes
from .references import factor_reference
from .scenes import SCENES

Resolutions = Annotated[
    Any, typer.Option("--resolutions", parser=whole_numbers, help="Pixels of an edge.", metavar="N,...")
]


def hemicube_rays(resolution: int) -> tuple[Array, Array]:
    """Directions (k, 3) through the pixels of half a cube around the normal z, and the form factor of each (k,): the
    cosines at both ends over pi r^2, times the area of a pixel [Cohen 1985]. ``resolution``: pixels of an edge."""
    side = 2 / resolution
    at = (np.arange(resolution) + 0.5) * side - 1
    a, b = (x.ravel() for x in np.meshgrid(at, at, indexing="ij"))
    top = np.column_stack([a, b, np.ones_like(a)])
    walls = [np.column_stack(np.broadcast_arrays(*w)) for w in ((1, a, b), (-1, a, b), (a, 1, b), (a, -1, b))]
    rays = np.concatenate([top, *(wall[b > 0] for wall in walls)])
    square = (rays**2).sum(axis=1)
    delta = np.maximum(rays[:, 2], 0) / (np.pi * square**2) * side**2
    return rays / np.sqrt(square)[:, None], delta


def hemicube_form_factors(scene: RayScene, resolution: int) -> Array:
    """Form factors (n, n) from the centre of each patch, whose extent is neglected."""
    patches = scene.patches
    rays, delta = hemicube_rays(resolution)
    matrix = np.zeros((len(patches), len(patches)))
    for i, (centre, normal) in enumerate(zip(scene.local(patches.centres), patches.normals, strict=True)):
        tangent, bitangent = (axis[0] for axis in across(normal[None]))
        ways = rays @ np.stack([tangent, bitangent, normal])
        found = scene.first_patches(np.broadcast_to(centre + STEP * normal, ways.shape), ways)
        matrix[i] = np.bincount(found, delta, len(patches) + 2)[: len(patches)]
    return matrix


def measure(
    scenes: Scenes = "nine-cubes,test-one",
    resolutions: Resolutions = "16,32,64",
    detail: Detail = 1.0,
    bundles: ReferenceBundles = BUNDLES,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        scene = RayScene(SCENES[name](detail))
        patches = scene.patches
        exact, noise = factor_reference(patches, bundles)
        record = Record(
            f"Hemicube, {name}, {len(patches)} patches: sum of squared errors of form factors",
            ("rays of a patch", "hemicube", "local lines", "global lines, F1", "CPU s: hemicube", "local", "global"),
        )
        for resolution in resolutions:
            rays = len(hemicube_rays(resolution)[1])
            errors, seconds = _compared(scene, exact, resolution, rays)
            cells = (f"{value:.3g}" for value in (*errors, *seconds))
            record.add(f"{rays} ({resolution} x {resolution} above)", *cells)
        record.notes += [
            "as many rays a patch, and as many global lines as rays of all patches in 1024 bundles; Sobol' points",
            "the hemicube takes the centre of a patch for the whole of it, and pixels for what is seen in them: its "
            f"error has an end; noise of the reference: {noise:.2g}",
        ]
        yield record


def _compared(scene: RayScene, exact: FormFactors, resolution: int, rays: int) -> tuple[list[float], list[float]]:
    """Errors and CPU seconds of the three ways."""
    patches, found = scene.patches, dict[str, Any]()
    lines = max(rays * len(patches) / 1024, 16.0)

    def by_lines() -> None:
        found["global"] = form_factors(ABuffer(patches, OwenSobol(4, seed=1), lines).cast(1024))

    def by_rays() -> None:
        found["local"] = local_form_factors(scene, rays)

    def by_hemicubes() -> None:
        found["hemicube"] = hemicube_form_factors(scene, resolution)

    seconds = [timed(work).cpu for work in (by_hemicubes, by_rays, by_lines)]
    truth = np.asarray(exact.matrix.todense())
    errors = [float(((found["hemicube"] - truth) ** 2).sum())]
    return [*errors, *(pair_errors(found[key], exact) for key in ("local", "global"))], seconds
