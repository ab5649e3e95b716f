"""Choose a method by a probe: the candidate that needs the least time for a given error renders the picture.

The candidates render the first passes of the picture in turn: ``path``, then ``vcm``, which finds more light than the
others, then ``bpt``. A candidate is tried only if its predicted time, including compilation, fits into :data:`_SHARE`
of the work ahead. The passes of the chosen candidate are used in the picture.

The cost of a candidate is the time of a pass times the error of a picture of :data:`_PASSES` passes. This error is the
sum of two parts:

- the variance between its passes, and
- the light that it has missed: the excess of another candidate's picture over its own, in blocks of pixels. A method
  that cannot find a caustic has no noise from it, so the variance alone would favour it. More passes reduce the
  variance, but light that was not found in the probe will be missing, or a firefly, in the picture.

If ``vcm`` does not fit, mostly because kernels have to be compiled, there is no comparison: ``vcm`` is chosen if the
scene has mirrors or glass and lights other than an environment. Its error is rarely twice that of the best candidate,
whereas that of ``path`` may be a thousand times as large. There is no probe for work of less than :data:`_LEAST`
seconds: ``bpt`` is chosen if the scene has mirrors or glass and lights that no ray can hit, whose caustics ``path``
never finds, else ``path``.

The choice is in the picture's metadata, and a resumed run keeps it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import RELATIVE_EPSILON, Carrying, Measurement, Pass, Result, State, logger, setting
from etendue.scene import Problem, materials

from .base import STEP_LANES, ImageMethod, ImageSettings, Layer
from .bidirectional import Bpt, Vcm
from .path import Path

#: Side of the blocks in which pictures are compared for missing light, in pixels.
_BLOCK = 4
#: Share of the work ahead that the predicted time of the probe may have. The real time must not exceed a fifth; the
#: difference is for predictions that are too low.
_SHARE = 0.17
#: Seconds of work below which there is no probe.
_LEAST = 6.0
#: Without a comparison, ``vcm`` is chosen only if ``path`` has taken less than this share of the work without the
#: preparation of ``vcm``.
_LOST = 0.2
#: Memory of the passes of the probe, in bytes per pixel; and its limit in bytes if the run has none.
_BYTES = 600
_ROOM = 1.2e9
#: The candidates, the simplest first: name, method, settings.
CANDIDATES: dict[str, tuple[type[ImageMethod], dict[str, Any]]] = {
    "path": (Path, {}),
    "bpt": (Bpt, {}),
    "bpt with 6 connections": (Bpt, {"connections": 6, "shadow_roulette": 0.05}),
    "vcm": (Vcm, {}),
}
#: Predicted times of a candidate: another candidate, and factors on the time of its preparation with compilation and on
#: that of its pass. A candidate is tried only after this other one.
_PREDICTED = {
    "vcm": ("path", 4.0, 2.5),
    "bpt": ("vcm", 1.0, 0.9),
    "bpt with 6 connections": ("bpt", 1.7, 1.9),
}
#: Passes of a picture, if no budget is given.
_PASSES = 64
#: Least ratio of costs at which the simpler of two candidates is chosen.
_WORTH_IT = 0.9
#: Factors on the costs if caustics are expected: a candidate may find them too rarely to appear in the probe.
_DOUBT = {"path": 2.0, "bpt": 1.5, "bpt with 6 connections": 1.5, "vcm": 0.9}
#: Variants of a candidate whose cost exceeds that of the best by more than this factor are not tried.
_HOPELESS = 3.0
#: Candidates render further passes if their costs are within this factor of the least.
_CLOSE = 1.5
#: Variants, and the candidates of which they are variants.
_VARIANTS = {"bpt with 6 connections": "bpt"}


@dataclass(frozen=True)
class AutoSettings(ImageSettings):
    """Settings of ``auto``."""

    choice: str = setting(
        "probe",
        "candidate that renders the picture; probe: the one that a probe finds best",
        choices=("probe", *CANDIDATES),
    )
    probe_passes: int = setting(
        6, "most passes that a candidate renders in the probe; more: a better comparison", minimum=2, maximum=1000
    )


@dataclass(eq=False)
class _Tried:
    """A candidate in the probe."""

    method: ImageMethod
    passes: list[Pass]
    total: Measurement  #: sum of the passes
    start: float  #: seconds of preparation and compilation
    seconds: float  #: seconds of a pass


class Auto(Carrying, ImageMethod):
    """The candidate that a probe finds best."""

    name: ClassVar[str] = "auto"
    Settings: ClassVar[type[ImageSettings]] = AutoSettings
    settings: AutoSettings
    citations: ClassVar[tuple[str, ...]] = (*Path.citations, *Vcm.citations)
    carries_on: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. The probe is part of the first pass, so that it counts against a budget."""
        self._forget_states()
        super().prepare(problem, seed)
        self._choice = self.settings.choice
        self._costs: dict[str, float] = {}
        self._chosen: ImageMethod | None = None
        self._carried: State = {}  #: state of the chosen candidate
        self._made: dict[tuple[int, int], Pass] = {}  #: passes of the probe, by iteration and seed
        self.setup_seconds = 0.0  #: seconds of the probe, which is part of the first pass
        self.plan(None, None, None)

    def plan(self, seconds: float | None, passes: int | None, error: float | None) -> None:
        """See :class:`Method`."""
        self._seconds, self._passes, self._error = seconds, passes, error

    def _step(self, iteration: int, seed: int) -> Measurement:
        """One pass of the chosen candidate."""
        renderer = self._renderer(seed)
        made = self._made.pop((iteration, seed), None)
        if made is None:
            made = renderer.step(iteration, seed, self._carried)
        self._carried = made.state
        return made.measurement

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        return self._renderer(seed).render_pass(iteration, seed, samples)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """Mean over the passes; the metadata contain the choice and the costs of the candidates."""
        result = super().develop(measurement, state)
        result.metadata |= {"chosen": state["choice"], "probe": state["costs"]}
        return result

    def _left(self) -> State:
        """The choice, the costs of the candidates, and the state of the chosen one."""
        return {"choice": self._choice, "costs": self._costs, "chosen": self._carried}

    def _take(self, state: State) -> None:
        self._choice, self._costs, self._chosen = str(state["choice"]), dict(state["costs"]), None
        self._carried, self._made = state["chosen"], {}

    def _renderer(self, seed: int) -> ImageMethod:
        if self._chosen is None:
            begin = time.perf_counter()
            if self._choice == "probe":
                self._choice = self._probe(seed)
                listed = ", ".join(f"{name} {cost:.3g}" for name, cost in self._costs.items()) or "not probed"
                logger.info("auto: %s (cost: %s)", self._choice, listed)
            if self._chosen is None:
                self._chosen = self._method(self._choice)
                self._chosen.prepare(self.problem, seed)
            self._carried = self._carried or self._chosen.start()
            self.setup_seconds = time.perf_counter() - begin
        return self._chosen

    def _method(self, name: str) -> ImageMethod:
        cls, settings = CANDIDATES[name]
        own = self.settings
        shared = ("max_depth", "sampler", "scrambling", "reconstruction", "aovs", "components")
        common = {name: getattr(own, name) for name in shared}
        return cls(cls.Settings(samples_per_pass=self.samples_per_iteration, **common, **settings))

    def full_lanes(self) -> int:
        """The same for all candidates, so that their passes can be compared."""
        return STEP_LANES

    # ------------------------------------------------------------------ the probe

    def _simple(self) -> str:
        """The candidate for work that is too short for a probe."""
        delta = mi.EmitterFlags.DeltaPosition, mi.EmitterFlags.DeltaDirection
        missed = self._has_specular() and any(mi.has_flag(e.flags(), f) for e in self.scene.emitters() for f in delta)
        return "bpt" if missed and self.camera.can_splat else "path"

    def _expects_caustics(self) -> bool:
        """Whether the scene has mirrors or glass, and lights other than an environment."""
        infinite = mi.EmitterFlags.Infinite
        return self._has_specular() and any(not mi.has_flag(e.flags(), infinite) for e in self.scene.emitters())

    def _has_specular(self) -> bool:
        bsdfs = [m for m in materials(self.scene) if isinstance(m, mi.BSDF)]
        specular = mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission
        return any(mi.has_flag(m.flags(), f) for m in bsdfs for f in specular)

    def _probe(self, seed: int) -> str:
        """Name of the candidate with the least cost; its passes are kept."""
        simple = self._simple()
        room = min(_ROOM, self.problem.memory or _ROOM)
        if (self._seconds is not None and self._seconds < _LEAST) or _BYTES * self.camera.pixels > room:
            return simple
        begin = time.perf_counter()
        tried = {"path": self._try("path", seed)}
        work = self._work(tried["path"])
        end = begin + _SHARE * work if work >= _LEAST else begin
        for name, (reference, start, pace) in _PREDICTED.items():
            base = tried.get(reference)
            if base is None or time.perf_counter() + start * base.start + 2.0 * pace * base.seconds > end:
                continue
            if name not in _VARIANTS or reference in _within(_HOPELESS, self._costs):
                tried[name] = self._try(name, seed)
                self._costs = _costs(tried)
        for _ in range(2, self.settings.probe_passes):
            left = [tried[name] for name in _within(_CLOSE, self._weighed())]
            if len(left) < 2 or time.perf_counter() + sum(one.seconds for one in left) > end:
                break
            for one in left:
                self._try_again(one, seed)
            self._costs = _costs(tried)
        if len(tried) > 1:
            chosen = choose(self._weighed())
        else:
            chosen = "vcm" if self._is_worth_vcm(work, time.perf_counter() - begin, tried["path"]) else simple
        if chosen in tried:
            self._chosen = tried[chosen].method
            self._made = {(i, seed): measured for i, measured in enumerate(tried[chosen].passes)}
        return chosen

    def _weighed(self) -> dict[str, float]:
        """Costs with the factors for caustics, the simplest candidate first."""
        factors = _DOUBT if self._expects_caustics() else dict.fromkeys(CANDIDATES, 1.0)
        return {name: factors[name] * self._costs[name] for name in CANDIDATES if name in self._costs}

    def _is_worth_vcm(self, work: float, spent: float, path: _Tried) -> bool:
        """Whether to choose ``vcm`` without a comparison for ``work`` seconds, of which ``path`` has taken
        ``spent``."""
        _, start, _ = _PREDICTED["vcm"]
        return work >= _LEAST and self._expects_caustics() and spent < _LOST * (work - start * path.start)

    def _try(self, name: str, seed: int) -> _Tried:
        """Render the first two passes of a candidate; the first includes compilation."""
        begin = time.perf_counter()
        method = self._method(name)
        method.prepare(self.problem, seed)
        first = method.step(0, seed, method.start())
        start = time.perf_counter() - begin
        tried = _Tried(method, [first], first.measurement.copy(), start, 0.0)
        self._try_again(tried, seed)
        tried.start = max(0.0, start - tried.seconds)
        return tried

    def _try_again(self, tried: _Tried, seed: int) -> None:
        begin = time.perf_counter()
        done = len(tried.passes)
        made = tried.method.step(done, seed, tried.passes[-1].state)
        tried.passes.append(made)
        tried.total += made.measurement
        tried.seconds = (tried.seconds * (done - 1) + time.perf_counter() - begin) / done

    def _work(self, tried: _Tried) -> float:
        """Predicted seconds of the picture with a candidate."""
        limits = []
        if self._seconds is not None:
            limits.append(self._seconds)
        if self._passes is not None:
            limits.append(self._passes * tried.seconds)
        if self._error is not None:
            passes = len(tried.passes) * tried.total.relative_error() / self._error
            limits.append(passes * tried.seconds)
        return min(limits, default=_PASSES * tried.seconds)


def _costs(tried: Mapping[str, _Tried]) -> dict[str, float]:
    return costs(
        {name: one.seconds for name, one in tried.items()},
        {name: [made.measurement for made in one.passes] for name, one in tried.items()},
    )


def _within(ratio: float, cost: Mapping[str, float]) -> list[str]:
    """Names of the candidates whose cost is at most ``ratio`` times the least."""
    return [name for name, value in cost.items() if value <= ratio * min(cost.values())]


def costs(seconds: Mapping[str, float], passes: Mapping[str, Sequence[Measurement]]) -> dict[str, float]:
    """Seconds of a picture of :data:`_PASSES` passes times its error, by candidate. ``seconds``: of a pass;
    ``passes``: measurements of single passes with equal weights."""
    blocks = {name: np.stack([_blocks(m.mean()) for m in each]) for name, each in passes.items()}
    pictures = {name: each.mean(axis=0) for name, each in blocks.items()}
    #: Variance of the mean of a block, estimated from passes, because its pixels may be correlated.
    variance = {name: each.var(axis=0, ddof=1) / len(each) for name, each in blocks.items()}
    # The error is relative to the median picture: a firefly would increase its own denominator.
    level = np.median(list(pictures.values()), axis=0)
    result = {}
    for name, each in passes.items():
        missed = np.zeros_like(level)
        for other in passes:
            # Only what exceeds three standard errors, so that fireflies of the other picture do not count.
            threshold = 9.0 * (variance[name] + variance[other])
            gap = np.square(np.maximum(pictures[other] - pictures[name], 0.0)) - threshold
            missed = np.maximum(missed, gap / (np.square(pictures[other]) + RELATIVE_EPSILON))
        noise = _blocks(np.stack([m.mean() for m in each]).var(axis=0, ddof=1))  # variance of a pixel in one pass
        scatter = noise / (np.square(level) + RELATIVE_EPSILON)
        error = scatter.mean() / _PASSES + missed.mean()
        result[name] = seconds[name] * _PASSES * float(error)
    return result


def choose(cost: Mapping[str, float]) -> str:
    """The candidate of least cost; a later one must cost less than :data:`_WORTH_IT` times as much as an earlier
    one."""
    best = ""
    for name, value in cost.items():
        if not best or value < _WORTH_IT * cost[best]:
            best = name
    return best


def _blocks(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over blocks of pixels, without the pixels at the border that do not fill a block."""
    height, width, channels = image.shape
    rows, columns = max(1, height // _BLOCK), max(1, width // _BLOCK)
    side_y, side_x = min(_BLOCK, height), min(_BLOCK, width)
    cut = image[: rows * side_y, : columns * side_x]
    return cut.reshape(rows, side_y, columns, side_x, channels).mean(axis=(1, 3))
