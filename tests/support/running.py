"""Short runs of methods and of Mitsuba's own path tracer, kept pass by pass so that their variance is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from etendue import methods
from etendue.core import Measurement


@dataclass
class Run:
    """Some passes of one method: their sum, and each pass's own picture, (passes, height, width, 3)."""

    measurement: Measurement
    images: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        return self.measurement.mean()


class Stepped:
    """A prepared method and the state after its last pass: what is asked of it, and set, is the method's."""

    def __init__(self, method: Any) -> None:
        self.__dict__.update(method=method, _state=None)

    def step(self, iteration: int, seed: int) -> Measurement:
        made = self.method.step(iteration, seed, self.state())
        self.__dict__["_state"] = made.state
        return made.measurement

    def state(self) -> Any:
        return self.method.start() if self._state is None else self._state

    def restore(self, state: Any) -> None:
        self.method.enter(state)
        self.__dict__["_state"] = state

    def develop(self, measurement: Measurement) -> Any:
        return self.method.develop(measurement, self.state())

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["method"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.method, name, value)


def prepared(problem: Any, method: str, seed: int = 1, **settings: Any) -> Any:
    """A method made ready for ``problem``, to be stepped; with independent numbers unless asked otherwise, as passes of
    an even sequence are not independent of each other, which the tests of agreement need."""
    cls = methods.get(method)
    settings = {"sampler": "independent"} | settings
    result = cls(cls.Settings.from_mapping(settings))
    result.prepare(problem, seed)
    return Stepped(result)


def run(
    problem: Any, method: str, passes: int = 6, samples: int = 128, seed: int = 1, first: int = 0, **settings: Any
) -> Run:
    """``passes`` passes of ``samples`` camera paths per pixel, from iteration ``first`` on."""
    return go(prepared(problem, method, seed, samples_per_pass=samples, **settings), passes, seed, first)


def replicas(
    problem: Any, method: str, runs: int = 6, passes: int = 3, samples: int = 128, seed: int = 1, **settings: Any
) -> np.ndarray:
    """Pictures of independent runs, a seed each, of a method whose passes learn from each other: (runs, h, w, 3)."""
    return np.stack([run(problem, method, passes, samples, seed + i, **settings).mean for i in range(runs)])


def go(runner: Any, passes: int, seed: int = 1, first: int = 0) -> Run:
    """Step a prepared method."""
    total, images = None, []
    for iteration in range(first, first + passes):
        measurement = runner.step(iteration, seed)
        images.append(measurement.mean())
        total = measurement if total is None else total + measurement
    assert total is not None
    return Run(total, np.stack(images))


def mitsuba_path(
    problem: Any, passes: int = 6, samples: int = 128, seed: int = 1000, max_depth: int = -1
) -> np.ndarray:
    """Pictures of Mitsuba's own ``path``, one a seed: (passes, height, width, 3)."""
    integrator = mi.load_dict({"type": "path", "max_depth": max_depth})
    return mitsuba_images(problem, integrator, passes, samples, seed)


def mitsuba_images(problem: Any, integrator: Any, passes: int, samples: int, seed: int) -> np.ndarray:
    """Pictures of a Mitsuba integrator, one a seed."""
    images = [
        np.array(mi.render(problem.scene, sensor=problem.sensor, integrator=integrator, spp=samples, seed=seed + i))
        for i in range(passes)
    ]
    return np.stack(images).astype(np.float64)
