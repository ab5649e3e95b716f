"""Small pictures while the camera moves: paths of few edges, one a pixel, at a resolution that keeps the pace."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from etendue import methods
from etendue.scene import Problem, resized

from .camera import Pose, place

#: Seconds that a moving picture should take, and pixels of the first one and the smallest.
_TARGET, _FIRST_PIXELS, _LEAST_PIXELS = 0.05, 40_000, 6_000
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
        self._method: methods.Path | None = None
        self._iteration = 0
        self._seconds: list[float] = []  # of the latest pictures of this resolution

    def picture(self, pose: Pose) -> NDArray[np.float32]:
        """The picture from a pose, (height, width, 3), smaller than the whole."""
        begin = time.perf_counter()
        if self._method is None:
            self._method = self._prepared()
            self._seconds = []
        place(self._method.problem.sensor, pose)
        self._iteration += 1
        layers, _ = self._method.render_pass(self._iteration, 0, 1)
        self._seconds.append(time.perf_counter() - begin)
        self._adapt()
        return layers["image"]

    def coarser(self) -> bool:
        """Use a lower resolution, after a failure; returns whether there is one."""
        return self._change(1)

    def _prepared(self) -> methods.Path:
        width, height = self._problem.size
        scale = _STEPS[self._step]
        size = max(1, round(width / scale)), max(1, round(height / scale))
        values = {"max_depth": _EDGES, "samples_per_pass": 1, "sampler": "independent", "reconstruction": "independent"}
        method = methods.Path(methods.Path.Settings.from_mapping(values))
        method.prepare(resized(self._problem, size), 0)
        return method

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
        self._step, self._method = step, None
        return True
