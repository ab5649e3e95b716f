"""Small pictures while the camera moves: paths of few edges, one a pixel, at a resolution that keeps the pace.

A pass of a small picture spends most of its time in Python, which traces its kernel anew; ``dr.freeze`` keeps the trace
(of 17 to 52 ms of a tiny picture, 4 to 8 remain).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue import methods
from etendue.core import IndependentSource, logger, seed_key
from etendue.scene import Problem, resized

from .camera import Pose, place

#: Seconds that a moving picture should take, and pixels of the first one and the smallest.
_TARGET, _FIRST_PIXELS, _LEAST_PIXELS = 0.06, 60_000, 6_000
#: Ratios of the side of the picture to that of the moving picture.
_STEPS = (1, 1.5, 2, 3, 4, 6, 8, 12, 16)
#: Edges of the paths: light that is reflected twice.
_EDGES = 3
#: How deep device arrays lie in a prepared method.
_DEPTH = 5


class Preview:
    """Moving pictures of a scene. ``problem`` has the size of the whole picture."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        pixels = problem.size[0] * problem.size[1]
        self._step = next((i for i, s in enumerate(_STEPS) if pixels / s**2 <= _FIRST_PIXELS), len(_STEPS) - 1)
        self._pass: _Pass | None = None
        self._seconds: list[float] = []  # of the latest pictures of this resolution

    def picture(self, pose: Pose) -> NDArray[np.float32]:
        """The picture from a pose, (height, width, 3), smaller than the whole."""
        begin = time.perf_counter()
        if self._pass is None:
            self._pass = _Pass(resized(self._problem, self._size()))
            self._seconds = []
        picture = self._pass.picture(pose)
        self._seconds.append(time.perf_counter() - begin)
        self._adapt()
        return picture

    def coarser(self) -> bool:
        """Use a lower resolution, after a failure; returns whether there is one."""
        return self._change(1)

    def _size(self) -> tuple[int, int]:
        (width, height), scale = self._problem.size, _STEPS[self._step]
        return max(1, round(width / scale)), max(1, round(height / scale))

    def _adapt(self) -> None:
        """Change the resolution if the pace asks for it: the first picture of one, which may compile, does not count,
        and a higher one must be clearly fast enough, so that it does not change to and fro."""
        if len(self._seconds) < 4:
            return
        recent = sorted(self._seconds[-3:])[1]
        if recent > _TARGET:
            self._change(1)
        elif self._step > 0 and recent * (_STEPS[self._step] / _STEPS[self._step - 1]) ** 2 < 0.6 * _TARGET:
            self._change(-1)

    def _change(self, by: int) -> bool:
        step = self._step + by
        width, height = self._problem.size
        if not 0 <= step < len(_STEPS) or (by > 0 and width * height / _STEPS[step] ** 2 < _LEAST_PIXELS):
            self._seconds = []
            return False
        self._step, self._pass = step, None
        return True


class _Pass:
    """Pictures of one size: one path a pixel."""

    def __init__(self, problem: Problem) -> None:
        values = {"max_depth": _EDGES, "samples_per_pass": 1, "sampler": "independent", "reconstruction": "independent"}
        self._method = methods.Path(methods.Path.Settings.from_mapping(values))
        self._method.prepare(problem, 0)
        self._problem = problem
        held = _device_parts(self._method)
        self._function: Callable[..., mi.Color3f] = dr.freeze(self._radiance, state_fn=lambda *_: held)
        self._iteration = 0

    def picture(self, pose: Pose) -> NDArray[np.float32]:
        """The picture from a pose, (height, width, 3)."""
        place(self._problem.sensor, pose)
        key0, key1 = seed_key(0, "moving", self._iteration)
        keys = dr.opaque(mi.UInt32, key0), dr.opaque(mi.UInt32, key1)
        try:
            radiance = self._function(self._problem.scene, self._problem.sensor, *keys)
        except RuntimeError as error:
            if self._iteration or self._function == self._radiance:
                raise
            logger.debug("viewer: moving pictures are not frozen: %s", error)
            self._function = self._radiance
            radiance = self._function(self._problem.scene, self._problem.sensor, *keys)
        self._iteration += 1
        width, height = self._problem.size
        return np.array(dr.ravel(radiance), np.float32).reshape(height, width, 3)

    def _radiance(self, scene: mi.Scene, sensor: mi.Sensor, key0: mi.UInt32, key1: mi.UInt32) -> mi.Color3f:
        """``scene`` and ``sensor`` are those of the method, as arguments so that the frozen function knows them."""
        method = self._method
        lanes = dr.arange(mi.UInt32, method.camera.pixels)
        source = IndependentSource.of_key(lanes, key0, key1)
        ray, importance, _ = method.camera.primary(lanes, source)
        radiance, _ = method.kept(method.trace(ray, source).radiance * importance)
        return radiance


def _device_parts(root: object) -> list[Any]:
    """Device arrays and Mitsuba objects in étendue's objects below ``root``: the state of a frozen function."""
    found: list[Any] = []
    seen: set[int] = set()

    def walk(value: Any, depth: int) -> None:
        if value is None or depth > _DEPTH:
            return
        if isinstance(value, (mi.Object, mi.DiscreteDistribution)) or dr.is_jit_v(value):
            found.append(value)
        elif isinstance(value, (list, tuple)):
            for part in value:
                walk(part, depth + 1)
        elif isinstance(value, dict):
            for part in value.values():
                walk(part, depth + 1)
        elif type(value).__module__.startswith("etendue") and hasattr(value, "__dict__") and id(value) not in seen:
            seen.add(id(value))
            for part in vars(value).values():
                walk(part, depth + 1)

    walk(root, 0)
    return found
