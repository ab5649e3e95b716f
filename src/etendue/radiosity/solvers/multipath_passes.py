"""Multipath in passes, for what drives methods: budgets, progress, checkpoints, stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.core import CheckpointError, Iterations, Measurement, Pass, Result, State, seed_key, setting
from etendue.core import Settings as AnySettings
from etendue.points import OwenSobol
from etendue.surfaces import Patches, RayScene

from ..errors import RadiosityError
from ..lines.chained import ChainedRays
from ..lines.engine import LineEngine
from ..problem import PatchProblem
from .multipath import LineExchange, Multipath
from .shot import FirstShot, shot_at_patches, small_emitters

#: Points of a pass, by default.
_POINTS = 1 << 16
#: Least passes before an error is estimated.
_LEAST_PASSES = 16

#: Makes what casts lines for patches and a seed; successive lines must not be parallel.
MakeEngine = Callable[[Patches, int], LineEngine]


@dataclass(frozen=True, kw_only=True)
class MultipathSettings(AnySettings):
    """What decides the lines."""

    points_per_pass: int = setting(_POINTS, "points of lines of a pass", minimum=1)
    shot_rays: float = setting(0.0, "rays that send the light of small emitters first, 0 for none", minimum=0)


def even_lines(patches: Patches, seed: int) -> LineEngine:
    """Lines through pairs of points of the bounding sphere, by a scrambled Sobol' sequence."""
    return ChainedRays.through(RayScene(patches), OwenSobol(4, seed=seed_key(seed, "lines", 0)[0]))


class MultipathPasses:
    """:func:`multipath` in passes; implements ``core.Method``.

    Each pass sends the power of all patches along its lines. What they have not sent on in the end is the state that
    the next pass begins with; its growth is measured, so that replicas add. N passes are :func:`multipath` by as many
    lines, but for the unit of power: nobody has to know N beforehand. A sample of a budget is a point, its error the
    *square* of the standard error of the irradiance, mean over the surface in units of its mean, by the scatter of the
    passes: for an even sequence, an upper estimate.
    """

    name: ClassVar[str] = "multipath"
    carries_on: ClassVar[bool] = True
    Settings: ClassVar[type[AnySettings]] = MultipathSettings
    citations: ClassVar[tuple[str, ...]] = ("Sbert1996", "Castro2002")

    def __init__(self, settings: MultipathSettings | None = None, engine: MakeEngine = even_lines) -> None:
        self._options = settings or MultipathSettings()
        self.settings: AnySettings = self._options
        self._make_engine = engine

    @property
    def samples_per_iteration(self) -> int:
        """Points of a pass."""
        return self._options.points_per_pass

    def prepare(self, problem: PatchProblem, seed: int) -> None:
        """Build the engine, and send the light of small emitters. Raises :class:`RadiosityError` if nothing emits, and
        for an engine whose successive lines are parallel."""
        self.patches, self._seed = problem.patches, seed
        self._engine = self._make_engine(problem.patches, seed)
        self._exchange = LineExchange(self._engine, self.samples_per_iteration, self._shoot(seed))

    def start(self) -> State:
        """Nothing is on its way."""
        return {"unshot": np.zeros(self._exchange.shape)}

    def enter(self, state: State) -> None:
        """See ``core.Method``."""
        if np.shape(state.get("unshot", 0)) != self._exchange.shape:
            raise CheckpointError(f"the checkpoint is not of {len(self.patches)} patches; solve anew")

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """Exchange power along the lines of a pass."""
        if seed != self._seed:
            raise RadiosityError(f"lines of seed {seed} are cast by what was prepared with that seed, not {self._seed}")
        unshot, received = state["unshot"].copy(), np.zeros(self._exchange.shape)
        size, sent, segments = self.samples_per_iteration, np.zeros(self.patches.channels), 0
        for chunk in self._engine.stream(size, iteration * size):
            sent += self._exchange.along(chunk, unshot, received)
            segments += len(chunk)
        sums = {"received": received, "sent": sent, "unshot": unshot - state["unshot"]}
        measurement = Measurement(
            sums,
            dict.fromkeys(sums, 1.0),
            Iterations.single(iteration),
            squares={"received": received**2},
            counters={"rays": float(segments)},
        )
        return Pass(measurement, {"unshot": unshot})

    def solution(self, measurement: Measurement) -> Multipath:
        """What the passes have exchanged, those of several replicas together."""
        means = (measurement.mean(name) for name in ("sent", "unshot", "received"))
        return self._exchange.result(*means)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture: only how much was exchanged."""
        points = self.samples_per_iteration * len(measurement.iterations)
        return Result({}, {"points": points, "segments": int(measurement.counters["rays"])})

    def noise(self, measurement: Measurement) -> float | None:
        """Square of the standard error of the irradiance; ``None`` while it is not known."""
        passes = len(measurement.iterations)
        if passes < _LEAST_PASSES:
            return None
        mean = measurement.mean("received")[:-2]
        squares = measurement.squares["received"][:-2] / passes
        error, light = np.sqrt(np.maximum(squares - mean**2, 0) / (passes - 1)), mean
        if (shot := self._exchange.shot) is not None:
            areas = self.patches.areas[:, None]
            error, light = np.hypot(error, areas * shot.error), light + areas * shot.irradiance
        return float((error.sum() / light.sum()) ** 2) if light.any() else None

    def _shoot(self, seed: int) -> FirstShot | None:
        if not self._options.shot_rays:
            return None
        emitters = small_emitters(self.patches, 1.0)
        if not emitters.any():
            return None
        points = OwenSobol(4, seed=seed_key(seed, "first shot", 0)[0])
        return shot_at_patches(RayScene(self.patches), self._options.shot_rays, points, emitters)
