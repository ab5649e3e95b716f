"""A solution of radiosity that is refined while it is shown, or that is read from a file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, Measurement, OptionError, prepared
from etendue.film import LUMINANCE
from etendue.radiosity import (
    CastingSettings,
    FirstShot,
    LineCasting,
    Patches,
    PatchProblem,
    Segments,
    Solution,
    read_solution,
    scene_patches,
    solve,
)
from etendue.scene import Problem

#: Most patches of a solution that is shown.
MOST_PATCHES = 20_000
#: The system is solved again when the number of passes has grown by this factor.
_GROWTH = 1.5
#: Sequences of lines, whose variance gives the error.
_REPLICATES = 8
#: Most segments of lines that are kept, of eight bytes each: in all, or per patch if that gives more. A system of two
#: million segments is solved in about a second, during which the camera waits.
MOST_SEGMENTS, _PER_PATCH = 2_000_000, 200


class ShownSolution:
    """A solution of radiosity as the page draws it: patches and their values."""

    patches: Patches
    solution: Solution | None = None
    error: Array | None = None  #: of the irradiance; ``None`` if it is not known
    max_area: float | None = None
    bundles = 0  #: bundles of lines that were cast while it is shown
    is_done = False  #: whether :meth:`step` has nothing to do

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def step(self, seconds: float = 0.15) -> bool:
        """Work for ``seconds``; returns whether there is a new solution."""
        return False

    def mesh(self) -> dict[str, NDArray[Any]]:
        """Triangles (n, 3, 3) in render space, and the patches (n,) of their fronts and backs; for a side without a
        patch, the number of patches. Areas (patches,), and which patches emit light."""
        patches = self.patches
        second = np.flatnonzero(patches.faces[:, 2] != patches.faces[:, 3])
        corners = np.concatenate([patches.faces[:, :3], patches.faces[second][:, [0, 2, 3]]])
        face = np.concatenate([np.arange(len(patches.faces)), second])
        front, back = np.minimum(patches.sides, len(patches)).T
        return {
            "triangles": self._problem.space.from_scene(patches.vertices)[corners].astype(np.float32),
            "front": front[face].astype(np.uint32),
            "back": back[face].astype(np.uint32),
            "areas": patches.areas.astype(np.float32),
            "emits": patches.emission.any(axis=1),
        }

    def values(self) -> dict[str, NDArray[Any]]:
        """For each patch, in W/m^2: radiosity (n, 3), and luminances (n,) of radiosity, standard error and residual."""
        assert self.solution is not None
        solution, patches = self.solution, self.patches
        # The error of the light that a patch reflects; its own emission has no error.
        error = patches.reflectance * (0.0 if self.error is None else self.error)
        residual = solution.radiosity - patches.emission - patches.reflectance * solution.irradiance
        return {
            "radiosity": _coloured(solution.radiosity).astype(np.float32),
            "luminance": _luminance(solution.radiosity).astype(np.float32),
            "error": _luminance(error).astype(np.float32),
            "residual": np.abs(_luminance(residual)).astype(np.float32),
        }

    def names(self) -> tuple[list[str], NDArray[np.uint32]]:
        """Names of the shapes, and the number of each patch's shape."""
        shapes = self.patches.shapes
        if shapes is None:
            return ["a surface"], np.zeros(len(self.patches), np.uint32)
        return list(self.patches.shape_names), shapes.astype(np.uint32)

    def close(self) -> None:
        """End all work."""


class SavedSolution(ShownSolution):
    """A solution from a file of ``etendue radiosity``. Raises the errors of reading the file, and :class:`OptionError`
    for more than :data:`MOST_PATCHES`."""

    is_done = True

    def __init__(self, problem: Problem, path: Path) -> None:
        super().__init__(problem)
        self.solution, self.error = read_solution(path)
        self.patches = self.solution.patches
        if len(self.patches) > MOST_PATCHES:
            raise OptionError(f"{path} has {len(self.patches)} patches, more than {MOST_PATCHES} that can be drawn")


class LiveSolution(ShownSolution):
    """Lines cast in passes through the patches of a scene, and solutions from the lines so far.

    max_area: of a patch, in scene units; ``None`` for an area that gives about a thousand patches. Raises the errors of
    :func:`etendue.radiosity.scene_patches`, and :class:`OptionError` for more than :data:`MOST_PATCHES`.
    """

    def __init__(self, problem: Problem, max_area: float | None = None, seed: int = 0) -> None:
        super().__init__(problem)
        patches = scene_patches(problem)
        if max_area is None:
            max_area = float(patches.areas.sum()) / 1000
        if not max_area > 0:
            raise OptionError(f"the area of a patch is above zero, not {max_area:g}")
        if float(patches.areas.sum()) / max_area + len(patches) > 4 * MOST_PATCHES:
            raise OptionError(f"patches of at most {max_area:g} would be too many to look on: give a larger area")
        self.patches: Patches = patches.subdivided(max_area)
        if len(self.patches) > MOST_PATCHES:
            raise OptionError(f"{len(self.patches)} patches are more than {MOST_PATCHES}: give a larger area")
        self.max_area, self._seed = max_area, seed
        casting = LineCasting(CastingSettings(replicates=_REPLICATES))
        self._casting = prepared(casting, PatchProblem(self.patches, problem.source), seed)
        self._measurement: Measurement | None = None
        self._next = _REPLICATES  # passes at the next solution
        self._solved = 0  # passes of the latest solution
        self.passes = 0

    @property
    def bundles(self) -> int:  # type: ignore[override]
        """Number of bundles of lines so far."""
        return 0 if self._measurement is None else self._casting.bundles(self._measurement)

    @property
    def is_done(self) -> bool:  # type: ignore[override]
        """Whether the most segments that are kept are reached, and the solution uses all of them."""
        return self._is_full and self._solved == self.passes

    @property
    def _is_full(self) -> bool:
        measured = self._measurement if self.passes >= _REPLICATES else None
        return measured is not None and measured.counters["rays"] >= max(MOST_SEGMENTS, _PER_PATCH * len(self.patches))

    def step(self, seconds: float = 0.15) -> bool:
        """Cast lines for ``seconds``; returns whether there is a new solution."""
        end = time.perf_counter() + seconds
        while time.perf_counter() < end and self.passes < self._next and not self._is_full:
            made = self._casting.step(self.passes, self._seed, {}).measurement
            self._measurement = made if self._measurement is None else self._measurement + made
            self.passes += 1
        if self._measurement is None or self._solved == self.passes or not (self.passes >= self._next or self._is_full):
            return False
        self._solved = self.passes
        self._next = int(np.ceil(self._next * _GROWTH))
        segments: Segments = self._casting.segments(self._measurement)
        shot: FirstShot | None = self._casting.shot(self._measurement)
        self.solution = solve(self.patches, segments, "conjugate-gradient", shot=shot)
        self.error = self.solution.irradiance_error(segments)
        return True

    def close(self) -> None:
        """End the casting."""
        self._casting.close()


def _coloured(values: Array) -> Array:
    return np.broadcast_to(values, (len(values), 3)) if values.shape[1] == 1 else values[:, :3]


def _luminance(values: Array) -> Array:
    return np.asarray(_coloured(values) @ np.asarray(LUMINANCE))
