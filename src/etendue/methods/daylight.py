"""Daylight coefficients by paths from meters to the sky."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.core import Array, Iterations, Measurement, Method, OptionError, Pass, Result, Settings, SquaresOf, setting
from etendue.lighting import SkyPatches, compass
from etendue.scene import Problem
from etendue.transport import SkyViews

#: Paths of a pass, and most numbers of the coefficients of a pass.
_LANES, _MOST_NUMBERS = 1 << 20, 1 << 30
_COEFFICIENTS, _UNIFORM = "coefficients", "uniform"


@dataclass(frozen=True)
class SkySettings(Settings):
    """Settings of daylight coefficients."""

    patches: int = setting(1, "subdivision of the sky: 1 has Tregenza's 145 patches, m has 144 m^2 + 1", minimum=1)
    up: str = setting("z", "axis of the scene that is up", choices=("y", "z"))
    north: float = setting(
        0.0, "direction of north in degrees from the axis +y (up: z) or -z (up: y), clockwise seen from above"
    )
    max_depth: int = setting(-1, "edges of a path; 2: light that one surface reflects; -1: any number", minimum=-1)
    samples_per_pass: int = setting(0, "paths of a meter in a pass; 0: as many as fill the device", minimum=0)

    @property
    def frame(self) -> Array:
        """(3, 3), rows east, north and up in the coordinates of the scene."""
        return compass(self.up, self.north)


class SkyTracing(Method):
    """Paths from the meters of a problem to the patches of a sky.

    A measurement has the ``coefficients`` (meters, patches, 3), sums over paths, and their sums over patches. A sample
    of a budget is a path of each meter. The error is that of the irradiance of the meters by a uniform sky.
    """

    name: ClassVar[str] = "daylight"
    Settings: ClassVar[type[Settings]] = SkySettings
    least_passes = 16

    def __init__(self, settings: SkySettings | None = None) -> None:
        self.settings: SkySettings = settings if settings is not None else SkySettings()
        self.patches = SkyPatches(self.settings.patches)

    def prepare(self, problem: Problem, seed: int) -> None:
        """Build what the passes share. Raises :class:`OptionError` if there are too many coefficients."""
        if problem.size[0] * self.patches.count * 4 >= _MOST_NUMBERS:
            raise OptionError(
                f"{problem.size[0]} meters have too many coefficients of {self.patches.count} patches each"
            )
        self._meters = problem.size[0]
        self._views = SkyViews(problem, self.patches, self.settings.frame, self.settings.max_depth)

    def samples_for(self, problem: Problem) -> int:
        """See ``core.Method``."""
        return int(self.settings.samples_per_pass) or max(1, _LANES // problem.size[0])

    @property
    def samples_per_iteration(self) -> int:
        """Paths of each meter in a pass."""
        return int(self.settings.samples_per_pass) or max(1, _LANES // self._meters)

    def step(self, iteration: int, seed: int, state: Any) -> Pass:
        """Trace the paths of a pass."""
        paths = self.samples_per_iteration
        found, rays = self._views.trace(iteration * paths, paths, seed)
        sums = {_COEFFICIENTS: found, _UNIFORM: found.sum(axis=1)}
        measurement = Measurement(
            sums,
            dict.fromkeys(sums, float(paths)),
            Iterations.single(iteration),
            squares=SquaresOf(sums, sums),
            counters={"rays": float(rays), "samples": float(paths)},
        )
        return Pass(measurement, state)

    def develop(self, measurement: Measurement, state: Any) -> Result:
        """No picture."""
        return Result({}, {"method": self.name, "settings": self.settings.to_dict()})

    def noise(self, measurement: Measurement) -> float | None:
        """Square of the relative standard error of the irradiance by a uniform sky, mean over the meters."""
        if len(measurement.iterations) < 2:
            return None
        mean, variance = measurement.mean(_UNIFORM), measurement.variance_of_mean(_UNIFORM)
        lit = mean > 0.0
        return float(np.mean(variance[lit] / mean[lit] ** 2)) if lit.any() else None

    def coefficients(self, measurement: Measurement) -> tuple[Array, Array]:
        """(coefficients (meters, patches, 3), their standard errors; NaN after a single pass)."""
        variance = measurement.variance_of_mean(_COEFFICIENTS)
        return measurement.mean(_COEFFICIENTS), np.sqrt(variance)
