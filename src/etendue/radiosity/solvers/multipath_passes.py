"""Multipath in passes, as a method of the engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.core import (
    Array,
    CheckpointError,
    Iterations,
    Measurement,
    Method,
    Pass,
    Result,
    Settings as AnySettings,
    State,
    setting,
)
from etendue.surfaces import Patches, RayScene

from ..compiling import compiled
from ..errors import RadiosityError, check_no_period
from ..lines.chained import ChainedRays
from ..lines.generators import GENERATORS, SINGLE_LINES
from ..lines.sequences import LINE_POINTS, line_points
from ..problem import PatchProblem
from .multipath import LineExchange, Multipath
from .shot import FirstShot, shot_at_patches, small_emitters
from .system import Solution

#: Points of a pass, by default, and largest number of points that are cast at once.
_POINTS = _PIECE = 1 << 16
#: Smallest number of passes from which an error is estimated.
_LEAST_PASSES = 16


@dataclass(frozen=True, kw_only=True)
class MultipathSettings(AnySettings):
    """Settings that determine the lines."""

    points_per_pass: int = setting(_POINTS, "points of lines of a pass", minimum=1)
    shot: float = setting(0.0, "rays that send the light of small emitters first, 0 for none", minimum=0)
    point_set: str = setting("sobol", "what draws the lines", choices=tuple(LINE_POINTS))
    generator: str = setting("sphere-pairs", "how a line is made of a point", choices=SINGLE_LINES)

    def lines(self, patches: Patches, seed: int) -> ChainedRays:
        """The lines through patches."""
        points = line_points(self.point_set, seed, "lines")
        return ChainedRays(GENERATORS[self.generator](patches), RayScene(patches), points)


class MultipathPasses(Method):
    """Multipath: light is exchanged along single lines, of which none are stored; :func:`multipath` in passes.

    Each pass sends the power of all patches along its lines. The power that is still unshot after a pass is the state,
    with which the next pass begins. A measurement holds the growth of the unshot power, so measurements of replicas
    can be added. N passes are :func:`multipath` with as many lines, in another unit of power, so N need not be known
    in advance.

    A sample of a budget is a point. The error is the *square* of the standard error of the irradiance, averaged over
    the surface and divided by the mean irradiance. It is estimated from the variance of the passes; for a point
    sequence this is an upper estimate.
    """

    name: ClassVar[str] = "multipath"
    counts: ClassVar[str] = "points"
    carries_on: ClassVar[bool] = True
    Settings: ClassVar[type[AnySettings]] = MultipathSettings
    has_fast_noise: ClassVar[bool] = False
    citations: ClassVar[tuple[str, ...]] = ("Sbert1996", "Castro2002")

    def __init__(self, settings: MultipathSettings | None = None) -> None:
        self._options = settings or MultipathSettings()
        self.settings: AnySettings = self._options

    @property
    def samples_per_iteration(self) -> int:
        """Points of a pass."""
        return self._options.points_per_pass

    def prepare(self, problem: PatchProblem, seed: int) -> None:
        """Build the engine and send the light of small emitters. Raises :class:`RadiosityError` if nothing emits."""
        check_no_period(problem.patches, "method multipath")
        self.patches, self._seed = problem.patches, seed
        self._engine = self._options.lines(problem.patches, seed)
        self._exchange = LineExchange(self._engine, self.samples_per_iteration, self._shoot(problem, seed))

    def start(self) -> State:
        """No unshot power."""
        return {"unshot": np.zeros(self._exchange.shape)}

    def enter(self, state: State) -> None:
        """See ``core.Method``."""
        if np.shape(state.get("unshot", 0)) != self._exchange.shape:
            raise CheckpointError(f"the checkpoint is not of {len(self.patches)} patches; start a new solution")

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """Exchange power along the lines of a pass."""
        if seed != self._seed:
            raise RadiosityError(f"the method was prepared with seed {self._seed}, not {seed}: prepare it again")
        unshot, received = state["unshot"].copy(), np.zeros(self._exchange.shape)
        size, sent, segments = self.samples_per_iteration, np.zeros(self.patches.channels), 0
        ends = np.zeros((len(received), 3), np.int64)
        for chunk in self._engine.stream(size, iteration * size, min(size, _PIECE)):
            sent += self._exchange.along(chunk, unshot, received)
            compiled().count_ends(chunk, ends)
            segments += len(chunk)
        sums = {"received": received, "sent": sent, "unshot": unshot - state["unshot"]}
        sums |= {"segments": ends[:-2, 0].astype(np.float64), "to_sky": ends[:-2, 1].astype(np.float64)}
        measurement = Measurement(
            sums,
            dict.fromkeys(sums, 1.0),
            Iterations.single(iteration),
            squares={"received": received**2},
            counters={"rays": float(segments)},
        )
        return Pass(measurement, {"unshot": unshot})

    @property
    def shot(self) -> FirstShot | None:
        """The first shot; ``None`` if there is none."""
        return self._exchange.shot

    def solution(self, measurement: Measurement) -> Multipath:
        """The result of the passes of a measurement, which may be those of several replicas."""
        means = (measurement.mean(name) for name in ("sent", "unshot", "received"))
        return self._exchange.result(*means)

    def solved(self, measurement: Measurement) -> Solution:
        """:meth:`solution` as a :class:`Solution`, for files and pictures. Its only residual is the share of the sent
        power that is still unshot, in the channel where it is largest."""
        found, shot = self.solution(measurement), self.shot
        irradiance = measurement.mean("received")[:-2] / self.patches.divisors[:, None]
        segments, to_sky = measurement.mean("segments"), measurement.mean("to_sky")
        sky_share = np.divide(to_sky, segments, out=np.zeros_like(to_sky), where=segments > 0)
        unshot = np.abs(found.unshot).sum(axis=0)
        left = np.divide(unshot, found.sent, out=np.zeros_like(unshot), where=found.sent > 0)
        if shot is not None:
            irradiance = irradiance + shot.irradiance
        return Solution(self.patches, found.radiosity, irradiance, sky_share, (float(left.max()),), shot)

    def irradiance_error(self, measurement: Measurement) -> Array | None:
        """(n, c) standard error of the irradiance of :meth:`solved`, from the variance of the passes and of the first
        shot; ``None`` for a single pass."""
        passes, areas = len(measurement.iterations), self.patches.divisors[:, None]
        if passes < 2:
            return None
        squares, mean = measurement.squares["received"][:-2] / passes, measurement.mean("received")[:-2]
        error: Array = np.sqrt(np.maximum(squares - mean**2, 0) / (passes - 1)) / areas
        return error if self.shot is None else np.hypot(error, self.shot.error)

    def missed(self, measurement: Measurement) -> float:
        """Share of the expected segments that lines did not find. If it exceeds 0 by more than noise, faces that face
        the same way lie on each other: a line then meets only one of them."""
        expected = self._engine.expected(self.samples_per_iteration).sum()
        return 1 - float(measurement.mean("segments").sum() / expected)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture, only the numbers of points and segments."""
        points = self.samples_per_iteration * len(measurement.iterations)
        return Result({}, {"points": points, "segments": int(measurement.counters["rays"])})

    def noise(self, measurement: Measurement) -> float | None:
        """Square of the relative standard error of the irradiance; ``None`` for fewer than 16 passes."""
        error, areas = self.irradiance_error(measurement), self.patches.areas[:, None]
        if error is None or len(measurement.iterations) < _LEAST_PASSES:
            return None
        light = measurement.mean("received")[:-2].sum()
        if self.shot is not None:
            light += (areas * self.shot.irradiance).sum()
        return float(((areas * error).sum() / light) ** 2) if light > 0 else None

    def _shoot(self, problem: PatchProblem, seed: int) -> FirstShot | None:
        emitters = small_emitters(self.patches, 1.0)
        if not (self._options.shot and emitters.any()):
            return problem.lamps
        points = line_points(self._options.point_set, seed, "first shot")
        shot = shot_at_patches(RayScene(self.patches), self._options.shot, points, emitters)
        return shot if problem.lamps is None else shot + problem.lamps
