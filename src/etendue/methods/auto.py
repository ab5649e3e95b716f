"""Choose among the methods by a probe, then render by the one that needs the least time for a given error.

The candidates make the first passes of the picture in turn: ``path``, then ``vcm``, which finds what nothing else does,
then what lies between them; each if what it is predicted to take, compilation included, fits into :data:`_SHARE` of the
work ahead. The passes of the one that is chosen are kept.
A candidate's cost is the time of its passes times the error of a picture of :data:`_PASSES` of them, which is the sum
of two:

- the scatter of its passes, and
- the light that it has missed: what another candidate shows in blocks of pixels and it does not. A method that cannot
  find a caustic looks noiseless; its scatter alone would recommend it. More passes make the scatter less, but what was
  never found in the probe will be missed, or a firefly, in the picture, too.

Where ``vcm`` would not fit, mostly since kernels have to be compiled, it is taken without a comparison if there are
mirrors or glass and lamps other than a sky: it is seldom twice as bad as the best, ``path`` may be a thousand times.
Work of less than :data:`_LEAST` seconds is not worth a probe. It is done by ``bpt`` where light goes by mirrors or
glass from a lamp that no ray can hit, which ``path`` never finds, else by ``path``.

What the error of a path costs depends on the scene: connections on or off, how many, merging on or off are most of what
a user could set by hand. The choice is written into the picture's metadata, and kept when a run is resumed.
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

#: Side of the blocks of pixels in which missing light is looked for.
_BLOCK = 4
#: Share of the work ahead that the probe may take as predicted. It must not take more than a fifth; the rest is for
#: predictions that were too low.
_SHARE = 0.17
#: Seconds of work below which nothing is probed.
_LEAST = 6.0
#: Without a comparison, share of the work beside its preparation that ``path`` may have taken before ``vcm`` begins.
_LOST = 0.2
#: Bytes a pixel that the passes of the probe take before one is chosen, and what they may take without a memory limit.
_BYTES = 600
_ROOM = 1.2e9
#: What is chosen from, simplest first: name, method, settings.
CANDIDATES: dict[str, tuple[type[ImageMethod], dict[str, Any]]] = {
    "path": (Path, {}),
    "bpt": (Bpt, {}),
    "bpt with 6 connections": (Bpt, {"connections": 6, "shadow_roulette": 0.05}),
    "vcm": (Vcm, {}),
}
#: What a candidate is predicted to take: which one it is compared with, and how many times the seconds of that one's
#: preparation and compilation, and of its pass, it takes. It is tried only where that one was.
_PREDICTED = {
    "vcm": ("path", 4.0, 2.5),
    "bpt": ("vcm", 1.0, 0.9),
    "bpt with 6 connections": ("bpt", 1.7, 1.9),
}
#: Passes that a picture is taken to have, where nobody says.
_PASSES = 64
#: A candidate must promise this much less than a simpler one.
_WORTH_IT = 0.9
#: Factor on the cost where there are mirrors or glass, for caustics that a candidate finds so seldom that the probe is
#: too short to meet them.
_DOUBT = {"path": 2.0, "bpt": 1.5, "bpt with 6 connections": 1.5, "vcm": 0.9}
#: Variants of a candidate with so many times the cost of the best are not tried.
_HOPELESS = 3.0
#: Candidates are compared by further passes if their costs are within this ratio after two.
_CLOSE = 1.5
#: A variant of a candidate, which is tried only where that one is still in the race after its first passes.
_VARIANTS = {"bpt with 6 connections": "bpt"}


@dataclass(frozen=True)
class AutoSettings(ImageSettings):
    """Settings of ``auto``."""

    choice: str = setting("probe", "what renders: found by a probe, or given", choices=("probe", *CANDIDATES))
    probe_passes: int = setting(
        6, "passes that a candidate is probed with at most, the first ones of the picture", minimum=2, maximum=1000
    )


@dataclass(eq=False)
class _Tried:
    """A candidate in the probe."""

    method: ImageMethod
    passes: list[Pass]
    total: Measurement  #: of the passes
    start: float  #: seconds of preparation and compilation
    seconds: float  #: of a pass


class Auto(Carrying, ImageMethod):
    """The method and the switches that a probe recommends."""

    name: ClassVar[str] = "auto"
    Settings: ClassVar[type[ImageSettings]] = AutoSettings
    citations: ClassVar[tuple[str, ...]] = (*Path.citations, *Vcm.citations)
    carries_on: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """The probe itself belongs to the first pass, so that a budget in seconds pays for it."""
        self._forget_states()
        super().prepare(problem, seed)
        self._choice = self.settings.choice
        self._costs: dict[str, float] = {}
        self._chosen: ImageMethod | None = None
        self._carried: State = {}  #: of what was chosen
        self._made: dict[tuple[int, int], Pass] = {}  #: passes of the probe, by iteration and seed
        self.setup_seconds = 0.0  #: of the probe, which is a part of the first pass
        self.plan(None, None, None)

    def plan(self, seconds: float | None, passes: int | None, error: float | None) -> None:
        """See :class:`Method`."""
        self._seconds, self._passes, self._error = seconds, passes, error

    def _step(self, iteration: int, seed: int) -> Measurement:
        """One pass of what was chosen."""
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
        """Mean over the passes; the metadata say what was chosen and what the candidates' costs were."""
        result = super().develop(measurement, state)
        result.metadata |= {"chosen": state["choice"], "probe": state["costs"]}
        return result

    def _left(self) -> State:
        """The choice, what it was made by, and the state of what was chosen."""
        return {"choice": self._choice, "costs": self._costs, "chosen": self._carried}

    def _take(self, state: State) -> None:
        self._choice, self._costs, self._chosen = str(state["choice"]), dict(state["costs"]), None
        self._carried, self._made = state["chosen"], {}

    def _renderer(self, seed: int) -> ImageMethod:
        if self._chosen is None:
            begin = time.perf_counter()
            if self._choice == "probe":
                self._choice = self._probe(seed)
                told = ", ".join(f"{name} {cost:.3g}" for name, cost in self._costs.items()) or "not probed"
                logger.info("auto: %s (cost: %s)", self._choice, told)
            if self._chosen is None:
                self._chosen = self._method(self._choice)
                self._chosen.prepare(self.problem, seed)
            self._carried = self._carried or self._chosen.start()
            self.setup_seconds = time.perf_counter() - begin
        return self._chosen

    def _method(self, name: str) -> ImageMethod:
        cls, settings = CANDIDATES[name]
        own = self.settings
        common = {name: getattr(own, name) for name in ("max_depth", "sampler", "reconstruction", "aovs")}
        return cls(cls.Settings(samples_per_pass=self.samples_per_iteration, **common, **settings))

    def full_lanes(self) -> int:
        """Of all candidates, so that their passes can be held against each other."""
        return STEP_LANES

    # ------------------------------------------------------------------ the probe

    def _simple(self) -> str:
        """What renders in little time."""
        hidden = mi.EmitterFlags.DeltaPosition, mi.EmitterFlags.DeltaDirection
        lost = self._has_specular() and any(mi.has_flag(e.flags(), f) for e in self.scene.emitters() for f in hidden)
        return "bpt" if lost and self.camera.can_splat else "path"

    def _expects_caustics(self) -> bool:
        """Whether there are mirrors or glass, and lamps within the scene."""
        sky = mi.EmitterFlags.Infinite
        return self._has_specular() and any(not mi.has_flag(e.flags(), sky) for e in self.scene.emitters())

    def _has_specular(self) -> bool:
        parts = [m for m in materials(self.scene) if isinstance(m, mi.BSDF)]
        bent = mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission
        return any(mi.has_flag(m.flags(), f) for m in parts for f in bent)

    def _probe(self, seed: int) -> str:
        """Name of the candidate with the least time times error; its passes are kept."""
        simple = self._simple()
        room = min(_ROOM, self.problem.memory or _ROOM)
        if (self._seconds is not None and self._seconds < _LEAST) or _BYTES * self.camera.pixels > room:
            return simple
        begin = time.perf_counter()
        tried = {"path": self._try("path", seed)}
        work = self._work(tried["path"])
        end = begin + _SHARE * work if work >= _LEAST else begin
        for name, (known, start, pace) in _PREDICTED.items():
            base = tried.get(known)
            if base is None or time.perf_counter() + start * base.start + 2.0 * pace * base.seconds > end:
                continue
            if name not in _VARIANTS or known in _within(_HOPELESS, self._costs):
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
        """Costs with their doubts, the simplest candidate first."""
        doubt = _DOUBT if self._expects_caustics() else dict.fromkeys(CANDIDATES, 1.0)
        return {name: doubt[name] * self._costs[name] for name in CANDIDATES if name in self._costs}

    def _is_worth_vcm(self, work: float, spent: float, path: _Tried) -> bool:
        """Whether ``vcm`` is the better guess for ``work`` seconds, after ``spent`` of them on ``path``."""
        _, start, _ = _PREDICTED["vcm"]
        return work >= _LEAST and self._expects_caustics() and spent < _LOST * (work - start * path.start)

    def _try(self, name: str, seed: int) -> _Tried:
        """The first two passes of a candidate, of which the first compiles."""
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
        """Seconds that the picture will take if it is made by a candidate."""
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
    """Those whose cost is at most so many times the least."""
    return [name for name, value in cost.items() if value <= ratio * min(cost.values())]


def costs(seconds: Mapping[str, float], passes: Mapping[str, Sequence[Measurement]]) -> dict[str, float]:
    """Seconds of a pass times the error of a picture of :data:`_PASSES` passes, by candidate. A pass is as long as the
    others of its candidate."""
    blocks = {name: np.stack([_blocks(m.mean()) for m in each]) for name, each in passes.items()}
    pictures = {name: each.mean(axis=0) for name, each in blocks.items()}
    #: Of the mean of a block, whose pixels may share samples.
    uncertain = {name: each.var(axis=0, ddof=1) / len(each) for name, each in blocks.items()}
    # Relative to what most candidates see: a bright speck must not excuse itself by its own brightness.
    level = np.median(list(pictures.values()), axis=0)
    result = {}
    for name, each in passes.items():
        missed = np.zeros_like(level)
        for other in passes:
            # Beyond three standard errors: a lone bright sample of the other's is as uncertain as it is bright.
            doubt = 9.0 * (uncertain[name] + uncertain[other])
            gap = np.square(np.maximum(pictures[other] - pictures[name], 0.0)) - doubt
            missed = np.maximum(missed, gap / (np.square(pictures[other]) + RELATIVE_EPSILON))
        noise = _blocks(np.stack([m.mean() for m in each]).var(axis=0, ddof=1))  # of a pixel in one pass
        scatter = noise / (np.square(level) + RELATIVE_EPSILON)
        error = scatter.mean() / _PASSES + missed.mean()
        result[name] = seconds[name] * _PASSES * float(error)
    return result


def choose(cost: Mapping[str, float]) -> str:
    """The first candidate that no later one is well below."""
    best = ""
    for name, value in cost.items():
        if not best or value < _WORTH_IT * cost[best]:
            best = name
    return best


def _blocks(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over blocks of pixels; a rim that fills no block is left out."""
    height, width, channels = image.shape
    rows, columns = max(1, height // _BLOCK), max(1, width // _BLOCK)
    side_y, side_x = min(_BLOCK, height), min(_BLOCK, width)
    cut = image[: rows * side_y, : columns * side_x]
    return cut.reshape(rows, side_y, columns, side_x, channels).mean(axis=(1, 3))
