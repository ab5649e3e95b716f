"""Maps in files: writing them, and reading them for a loaded scene."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from etendue.formats import save_arrays
from etendue.scene import Problem, RenderSpace

from ..errors import SurfaceError
from ..faces import triangles
from ..patches import Patches
from ..places import PatchSurfaces
from ..savedpatches import saved_patches
from .cells import PatchMap
from .nearest import NearestMap
from .places import MapSurfaces, on_surfaces

#: Arrays of a map of particles.
_NEAREST = ("position", "direction", "power", "path", "k", "kernel", "correct")
#: Number of triangles whose centres are searched on the surfaces of the scene, and least share that must be found.
_TRIED, _THERE = 1000, 0.9


@dataclass
class _Saved:
    """Particles of a file."""

    position: NDArray[np.float32]
    direction: NDArray[np.float32]
    power: NDArray[np.float32]
    path: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.position)

    @property
    def is_sound(self) -> bool:
        """Whether the arrays have the shapes of particles."""
        rows = (self.position, self.direction, self.power)
        is_number = all(np.issubdtype(x.dtype, np.number) for x in (*rows, self.path))
        return is_number and self.path.ndim == 1 and all(x.shape == (len(self.path), 3) for x in rows)


def save_map(
    path: str | os.PathLike[str], made: PatchMap | NearestMap, metadata: Mapping[str, Any] | None = None
) -> None:
    """Write a map as ``.npz``, for :func:`read_map`. A :class:`PatchMap` has the arrays of a radiosity solution:
    vertices, faces, irradiance; a :class:`NearestMap` has its particles.

    metadata: values for JSON. Raises :class:`SurfaceError` for another suffix, :class:`etendue.core.OutputError` if the
    file cannot be written.
    """
    if Path(path).suffix.lower() != ".npz":
        raise SurfaceError(f"a map is written as .npz, not as '{path}'; change the name")
    if isinstance(made, NearestMap):
        rows = made.particles
        arrays: dict[str, Any] = {name: getattr(rows, name) for name in ("position", "direction", "power", "path")}
        arrays |= {"k": made.k, "kernel": made.kernel.name, "correct": made.correct}
    else:
        patches = made.surfaces.patches
        arrays = {name: getattr(patches, name) for name in ("vertices", "faces", "front", "back")}
        arrays |= {"irradiance": made.values, "smooth": made.smooth, "kind": made.kind}
        if made.errors is not None:
            arrays["irradiance_error"] = made.errors
    save_arrays(path, {name: np.asarray(value) for name, value in arrays.items()}, metadata)


def read_map(path: str | os.PathLike[str], problem: Problem) -> PatchMap | NearestMap:
    """A map of :func:`save_map`, or a radiosity solution in ``.npz``, for a loaded scene.

    Raises :class:`SurfaceError` for another file, and if the map is not of the surfaces of this scene.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            saved = {name: file[name] for name in file.files if name != "metadata"}
    except FileNotFoundError:
        raise SurfaceError(f"there is no file of a map '{path}'") from None
    except (OSError, ValueError, EOFError, KeyError, AttributeError, TypeError, BadZipFile) as error:
        raise _foreign(path) from error
    rows = None
    try:
        if "k" in saved:
            rows = _Saved(*(saved[name] for name in _NEAREST[:4]))
            k, kernel, correct = (saved[name].item() for name in _NEAREST[4:])
    except (KeyError, ValueError) as error:
        raise _foreign(path) from error
    if rows is not None:
        if not rows.is_sound:
            raise _foreign(path)
        return NearestMap(MapSurfaces(problem), rows, k, kernel, correct, problem.memory)
    try:
        patches, irradiance = saved_patches(saved), saved["irradiance"]
        smooth, kind = (saved[name].item() if name in saved else other for name, other in _OTHERWISE.items())
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise _foreign(path) from error
    check_place(patches, problem, f"'{path}' is a map")
    surfaces = PatchSurfaces(patches)
    errors = saved.get("irradiance_error")
    return PatchMap(surfaces, irradiance, errors, smooth=smooth, kind=kind, space=problem.space)


#: Values for a radiosity solution, whose file does not have them.
_OTHERWISE: dict[str, Any] = {"smooth": True, "kind": "radiosity"}


def check_place(patches: Patches, problem: Problem, what: str) -> None:
    """Raise :class:`SurfaceError` if the patches are not on the surfaces of a scene; ``what`` is "the solution is"."""
    corners, face = (x[:: -(-len(x) // _TRIED)] for x in triangles(patches.faces))  # a patch may not be flat
    centres, normals = patches.vertices[corners].mean(axis=1), patches.face_normals[face]
    # Flat patches of a curved surface lie inside it, by up to a hundredth of the radius of the scene.
    found = on_surfaces(problem.scene, problem.space, centres, -normals, reach=1e-2 * patches.sphere[1])
    if np.count_nonzero(found.hit) < _THERE * len(face):
        raise SurfaceError(
            f"{what} of another scene: {np.count_nonzero(~found.hit)} of {len(face)} of its faces are not on a surface "
            "of this one"
        )


def solution_map(solution: Any, smooth: bool = True, space: RenderSpace | None = None) -> PatchMap:
    """The irradiance of a radiosity solution, an :class:`etendue.radiosity.Solution`, as a map; ``space`` is that of
    the loaded scene."""
    surfaces = PatchSurfaces(solution.patches)
    return PatchMap(surfaces, solution.irradiance, smooth=smooth, kind="radiosity", space=space)


def _foreign(path: str | os.PathLike[str]) -> SurfaceError:
    return SurfaceError(f"'{path}' is no map: give an .npz of 'etendue particles map', or of a radiosity solution")
