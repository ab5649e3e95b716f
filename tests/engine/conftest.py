"""A method without a scene: numbers from a generator, in a picture of a few pixels."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from etendue.core import Iterations, Measurement, Method, Pass, Result, Settings, State, setting


@dataclass(frozen=True)
class NoiseSettings(Settings):
    """Settings of the fake."""

    max_depth: int = setting(-1, "depth", minimum=-1)
    samples_per_pass: int = setting(1, "samples of a pass", minimum=0)


class Noise(Method):
    """Each pass is noise around 1; deterministic in (seed, iteration)."""

    name: ClassVar[str] = "noise"
    Settings: ClassVar[type[Settings]] = NoiseSettings

    def __init__(self, settings: NoiseSettings | None = None) -> None:
        self.settings = settings or NoiseSettings()
        self.before_pass: Callable[[int], None] = lambda iteration: None
        self.shape = (4, 5, 3)
        self.pilot = 0.0

    @property
    def samples_per_iteration(self) -> int:
        return self.settings.samples_per_pass or 4

    def prepare(self, problem: Any, seed: int) -> None:
        self.pilot = float(seed) + 0.5

    def start(self) -> State:
        return {"pilot": self.pilot, "table": np.arange(3.0), "nested": {"list": [1, np.float32(2.0)]}}

    def enter(self, state: State) -> None:
        self.pilot = state["pilot"]

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        self.before_pass(iteration)
        return Pass(self.measured(iteration, seed), state)

    def measured(self, iteration: int, seed: int) -> Measurement:
        n = float(self.samples_per_iteration)
        value = np.random.default_rng([seed, iteration]).gamma(2.0, 0.5, self.shape)
        return Measurement(
            sums={"image": value * n, "emission": value * n / 3},
            weights={"image": n, "emission": n},
            iterations=Iterations.single(iteration),
            squares={"image": (value * n) ** 2},
            counters={"rays": 100.0},
        )

    def develop(self, measurement: Measurement, state: State) -> Result:
        return Result({name: measurement.mean(name).astype(np.float32) for name in measurement.sums})


class Clock:
    """Time that passes only where it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def noise() -> Noise:
    return Noise()


@pytest.fixture
def slow_noise() -> Noise:
    """Passes of 10 ms."""
    method = Noise()
    method.before_pass = lambda iteration: time.sleep(0.01)
    return method


@pytest.fixture
def timed() -> Callable[[list[float]], tuple[Noise, Clock]]:
    """A method whose passes take the given seconds (the last one repeats) on a clock of its own."""

    def make(durations: list[float]) -> tuple[Noise, Clock]:
        method, clock = Noise(), Clock()

        def advance(iteration: int) -> None:
            clock.now += durations[min(iteration, len(durations) - 1)]

        method.before_pass = advance
        return method, clock

    return make
