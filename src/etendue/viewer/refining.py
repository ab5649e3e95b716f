"""A picture that is refined pass by pass, by a method of the registry through the engine's protocol; or a picture
from a file."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue import film, methods
from etendue.core import Measurement, Replica, Result, Settings, State, prepared
from etendue.engine import LEAST_PASSES_FOR_ERROR, Budget, versions
from etendue.products import scene_settings
from etendue.scene import Problem
from etendue.transport import Rays

#: Growth of the number of passes between two estimates of the noise.
_CADENCE = 1.05
#: File name endings of pictures.
_PICTURES = (".exr", ".png", ".jpg", ".jpeg", ".hdr")


class Refinement:
    """Passes of one method on one view of a scene. Raises the errors of settings and preparation."""

    def __init__(
        self, problem: Problem, method: str, settings: Mapping[str, Any], budget: Budget, seed: int = 0
    ) -> None:
        begin = time.perf_counter()
        kind = methods.get(method)
        self.problem, self.budget, self.seed = problem, budget, seed
        self.settings = checked(problem, method, settings)
        # One sample a pass unless the settings give another number, so that the camera does not wait long.
        one = self.settings if self.settings.samples_per_pass else self.settings.replace(samples_per_pass=1)
        self._replica = Replica(self._prepared(kind, one), seed)
        self.method.plan(budget.seconds, budget.passes(self.method.samples_per_iteration), budget.error)
        self.measurement: Measurement | None = None
        #: Seconds of preparation and passes.
        self.seconds = time.perf_counter() - begin
        self.passes = 0
        self.noise: float | None = None
        self.rays_per_second: float | None = None
        self._next_noise = 2.0

    def _prepared(self, kind: type[Any], settings: Settings) -> Any:
        return prepared(kind(settings), self.problem, self.seed)

    @property
    def method(self) -> Any:
        """The prepared method."""
        return self._replica.method

    @property
    def samples(self) -> int:
        """Camera paths per pixel so far."""
        return self.passes * self.method.samples_per_iteration

    @property
    def is_done(self) -> bool:
        """Whether the budget is used up."""
        most = self.budget.passes(self.method.samples_per_iteration)
        return (
            (most is not None and self.passes >= most)
            or (self.budget.seconds is not None and self.seconds >= self.budget.seconds)
            or self._is_quiet
        )

    @property
    def _is_quiet(self) -> bool:
        """Whether the noise is within the budget's error, by an estimate from enough passes."""
        known = self.budget.error is not None and self.noise is not None and self.passes >= LEAST_PASSES_FOR_ERROR
        return known and self.noise <= self.budget.error  # type: ignore[operator]

    def step(self) -> None:
        """Make a pass and add it to the picture."""
        begin = time.perf_counter()
        made = self._replica.step(self.passes)
        seconds = time.perf_counter() - begin
        self.seconds += seconds
        rays = made.counters.get("rays", 0.0)
        if self.measurement is None:
            self.measurement = made
        else:
            self.measurement += made
        self.passes += 1
        self.rays_per_second = rays / seconds if rays and seconds > 0 else None
        if self.passes >= self._next_noise:
            self._next_noise = max(self.passes + 1, self.passes * _CADENCE)
            self.noise = self.method.noise(self.measurement)

    @property
    def state(self) -> State:
        """The state of the method after the last pass."""
        return self._replica.state

    def enter(self, state: State, passes: int) -> None:
        """Take the state after a number of passes that were made elsewhere. Errors as of ``Method.enter``."""
        self.method.enter(state)
        self._replica.state, self.passes = state, passes

    def rays(self, x: float, y: float, paths: int) -> Rays | None:
        """The rays of the next pass through a pixel, see :func:`etendue.methods.rays_through`."""
        try:
            return methods.rays_through(self.method, x, y, paths, self.passes, self.seed)
        finally:
            self.method.enter({**self.state})  # another object, so that it is loaded again

    def result(self) -> Result | None:
        """The picture so far with its layers, ``None`` before the first pass."""
        if self.measurement is None:
            return None
        result = self._replica.develop(self.measurement)
        result.metadata |= {
            "method": self.method.name,
            "settings": self.method.settings.to_dict(),
            "seed": self.seed,
            "scene": self.problem.source,
            "passes": self.passes,
            "samples": self.samples,
            "seconds": round(self.seconds, 3),
            "rays": self.measurement.counters.get("rays", 0.0),
            "relative_error": self.noise,
            "versions": versions(),
        }
        return result

    def progress(self) -> dict[str, Any]:
        """Plain values for the page."""
        return {
            "method": self.method.name,
            "passes": self.passes,
            "samples": self.samples,
            "seconds": self.seconds,
            "rays_per_second": self.rays_per_second,
            "noise": self.noise,
            "done": self.is_done,
        }


class Still:
    """A picture from a file with its layers, in place of a refined picture. Raises the errors of reading the file."""

    is_done, passes = True, 1

    def __init__(self, path: str | os.PathLike[str]) -> None:
        image = film.read_image(path)
        read = film.read_exr(path) if Path(path).suffix.lower() == ".exr" else Result({})
        self._result = Result(read.layers | {"image": image}, read.metadata)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        height, width = self._result.image.shape[:2]
        return int(width), int(height)

    @property
    def method(self) -> str:
        """The method that made the picture, if the file says so."""
        return str(self._result.metadata.get("method", "picture"))

    def result(self) -> Result:
        """The picture with its layers."""
        return Result(dict(self._result.layers), dict(self._result.metadata))

    def progress(self) -> dict[str, Any]:
        """Plain values for the page, as far as the file has them."""
        about = self._result.metadata
        known = {key: about.get(key, 0) for key in ("passes", "samples", "seconds")}
        return {
            "method": self.method,
            "rays_per_second": None,
            "noise": about.get("relative_error"),
            "done": True,
        } | known


def is_picture(source: Any) -> bool:
    """Whether a source is a picture file, by its ending."""
    return isinstance(source, (str, os.PathLike)) and Path(source).suffix.lower() in _PICTURES


def checked(problem: Problem, method: str, settings: Mapping[str, Any]) -> Any:
    """The settings of a method on a scene: the given ones, else those of the scene's integrator, else the defaults."""
    return scene_settings(methods.get(method), problem, settings)
