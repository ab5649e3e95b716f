"""A picture that is refined pass by pass, by a method of the registry through the engine's protocol; or a picture
from a file."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from etendue import film, methods
from etendue.core import Result, State, prepared
from etendue.engine import Budget, Runner
from etendue.products import developed, scene_settings
from etendue.scene import Problem
from etendue.transport import Rays

#: File name endings of pictures.
_PICTURES = (".exr", ".png", ".jpg", ".jpeg", ".hdr")


class _Stopwatch:
    """Seconds of what is done within :meth:`running`."""

    def __init__(self) -> None:
        self._sum = 0.0
        self._since: float | None = None

    def __call__(self) -> float:
        return self._sum + (0.0 if self._since is None else time.perf_counter() - self._since)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Count the seconds of this block."""
        self._since = time.perf_counter()
        try:
            yield
        finally:
            self._sum, self._since = self(), None


class Refinement:
    """Passes of one method on one view of a scene, made when the session has time. Raises the errors of settings and
    preparation."""

    def __init__(
        self, problem: Problem, method: str, settings: Mapping[str, Any], budget: Budget, seed: int = 0
    ) -> None:
        begin = time.perf_counter()
        kind: Any = methods.get(method)
        self.problem, self.budget, self.seed = problem, budget, seed
        self.settings = checked(problem, method, settings)
        # One sample a pass unless the settings give another number, so that the camera does not wait long.
        one = self.settings if self.settings.samples_per_pass else self.settings.replace(samples_per_pass=1)
        #: The prepared method.
        self.method = prepared(kind(one), problem, seed)
        self._clock, self._never = _Stopwatch(), threading.Event()  # a session needs no budget
        spent = time.perf_counter() - begin
        self._runner = Runner(self.method, seed=seed, budget=budget, cancel=self._never, spent=spent, clock=self._clock)
        self._runner.begin()
        self._entered: tuple[State, int] | None = None

    @property
    def passes(self) -> int:
        """Passes in the picture."""
        return self._runner.progress.passes if self._entered is None else self._entered[1]

    @property
    def samples(self) -> int:
        """Camera paths per pixel so far."""
        return self.passes * self.method.samples_per_iteration

    @property
    def seconds(self) -> float:
        """Seconds of preparation and passes."""
        return self._runner.progress.elapsed

    @property
    def is_done(self) -> bool:
        """Whether the budget is used up."""
        return self._runner.reason is not None

    def step(self) -> None:
        """Make a pass and add it to the picture."""
        with self._clock.running():
            self._runner.step()

    @property
    def state(self) -> State:
        """The state of the method after the last pass."""
        return self._runner.state if self._entered is None else self._entered[0]

    def enter(self, state: State, passes: int) -> None:
        """Take the state after a number of passes that were made elsewhere. Errors as of ``Method.enter``."""
        self.method.enter(state)
        self._entered = state, passes

    def rays(self, x: float, y: float, paths: int) -> Rays | None:
        """The rays of the next pass through a pixel, see :func:`etendue.methods.rays_through`."""
        try:
            return methods.rays_through(self.method, x, y, paths, self.passes, self.seed)
        finally:
            self.method.enter({**self.state})  # another object, so that it is loaded again

    def result(self) -> Result | None:
        """The picture so far with its layers, ``None`` before the first pass."""
        run = self._runner.current
        return None if run is None else developed(run, self.problem, self.seed)

    def progress(self) -> dict[str, Any]:
        """Plain values for the page."""
        progress = self._runner.progress
        return {
            "method": self.method.name,
            "passes": self.passes,
            "samples": self.samples,
            "seconds": self.seconds,
            "rays_per_second": progress.rays_per_second,
            "error": progress.error,
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
            "error": about.get("error"),
            "done": True,
        } | known


def is_picture(source: Any) -> bool:
    """Whether a source is a picture file, by its ending."""
    return isinstance(source, (str, os.PathLike)) and Path(source).suffix.lower() in _PICTURES


def checked(problem: Problem, method: str, settings: Mapping[str, Any]) -> Any:
    """The settings of a method on a scene: the given ones, else those of the scene's integrator, else the defaults."""
    return scene_settings(methods.get(method), problem, settings)
