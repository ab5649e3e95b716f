"""Small pictures while the camera moves: short paths, one a pixel, at a resolution that keeps the frame rate.

A pass of a small picture spends most of its time in Python, which traces its kernel anew; ``core.Frozen`` keeps the
trace (of 17 to 52 ms of a tiny picture, 4 to 8 remain).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue import methods
from etendue.core import Frozen, IndependentSource, prepared, seed_key
from etendue.scene import Problem, is_spectral, resized

from .camera import Pose, place

#: Seconds that a moving picture should take, and pixels of the first one and the smallest.
_TARGET, _FIRST_PIXELS, _LEAST_PIXELS = 0.028, 60_000, 6_000
#: After one picture that takes so many times the target the resolution is lowered.
_FAR = 3.0
#: Ratios of the side of the picture to that of the moving picture.
_STEPS = (1, 1.5, 2, 3, 4, 6, 8, 12, 16)
#: Edges of the paths: light that is reflected twice.
_EDGES = 3


class Preview:
    """Moving pictures of a scene. ``problem`` has the size of the whole picture."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        pixels = problem.size[0] * problem.size[1]
        self._step = next((i for i, s in enumerate(_STEPS) if pixels / s**2 <= _FIRST_PIXELS), len(_STEPS) - 1)
        self._made: dict[int, Moving] = {}  # by step
        self._seconds: list[float] = []  # of the latest pictures of this resolution

    def picture(self, pose: Pose) -> NDArray[np.float32]:
        """The picture from a pose, (height, width, 3), smaller than the whole."""
        begin = time.perf_counter()
        if self._step not in self._made:
            # Mitsuba 3.9.1 hides the aperture of a thin lens from frozen functions, and a pinhole is less noisy.
            self._made[self._step] = Moving(resized(self._problem, self._size(self._step), pinhole=True))
        picture = self._made[self._step].picture(pose)
        self._seconds.append(time.perf_counter() - begin)
        self._adapt()
        return picture

    def coarser(self) -> bool:
        """Use a lower resolution, after a failure; returns whether there is one."""
        before = self._step
        self._go_to(before + 1)
        self._made.pop(before, None)
        return self._step != before

    def _size(self, step: int) -> tuple[int, int]:
        (width, height), scale = self._problem.size, _STEPS[step]
        return max(1, round(width / scale)), max(1, round(height / scale))

    def _adapt(self) -> None:
        """Adapt the resolution to the measured times. The first picture at a resolution, which may compile, does not
        count, and a higher resolution must be clearly fast enough, so that resolutions do not alternate."""
        slow = len(self._seconds) > 1 and self._seconds[-1] > _FAR * _TARGET
        if len(self._seconds) < 4 and not slow:
            return
        recent = self._seconds[-1] if slow else sorted(self._seconds[-3:])[1]
        here = _STEPS[self._step]
        if recent > 1.2 * _TARGET:
            fits = (k for k, s in enumerate(_STEPS) if k > self._step and recent * (here / s) ** 2 < _TARGET)
            self._go_to(next(fits, len(_STEPS) - 1))
        elif self._step > 0 and recent * (here / _STEPS[self._step - 1]) ** 2 < 0.6 * _TARGET:
            self._go_to(self._step - 1)

    def _go_to(self, step: int) -> None:
        """Use another resolution, or the lowest that is useful."""
        while step > self._step and math.prod(self._size(min(step, len(_STEPS) - 1))) < _LEAST_PIXELS:
            step -= 1
        step = min(step, len(_STEPS) - 1)
        self._step, self._seconds = step, []


class Moving:
    """Pictures of one size: one path a pixel. ``frozen``: whether the trace of the kernel is kept, if it can be."""

    def __init__(self, problem: Problem, frozen: bool = True) -> None:
        values = {"max_depth": _EDGES, "samples_per_pass": 1, "sampler": "independent", "reconstruction": "independent"}
        self._method = prepared(methods.Path(methods.Path.Settings.from_mapping(values)), problem, 0)
        self._problem = problem
        self._function: Callable[..., mi.Color3f] = self._radiance
        if frozen:
            self._function = Frozen(self._radiance, self._method.tables)
        self._iteration = 0

    def picture(self, pose: Pose) -> NDArray[np.float32]:
        """The picture from a pose, (height, width, 3)."""
        place(self._problem.sensor, pose)
        key0, key1 = seed_key(0, "moving", self._iteration)
        keys = dr.opaque(mi.UInt32, key0), dr.opaque(mi.UInt32, key1)
        radiance = self._function(*keys)
        self._iteration += 1
        width, height = self._problem.size
        picture = np.array(dr.ravel(radiance), np.float32).reshape(height, width, 3)
        return picture / np.float32(self._method.packet.white) if is_spectral() else picture

    def _radiance(self, key0: mi.UInt32, key1: mi.UInt32) -> mi.Color3f:
        method = self._method
        lanes = dr.arange(mi.UInt32, method.camera.pixels)
        source = IndependentSource.of_key(lanes, key0, key1)
        ray, importance, _ = method.camera.primary(lanes, source)
        radiance, _ = method.kept(method.trace(ray, source).radiance * importance)
        return radiance
