"""Choose among the methods by a probe, then render by the one that needs the least time for a given error.

The first pass is preceded by a few passes of each candidate on a small copy of the film; one that is far behind after
two or four of them is given up. A candidate's cost is the time of its passes times the error of a picture of
:data:`_PASSES` of them, which is the sum of two:

- the scatter of its passes, and
- the light that it has missed: what another candidate shows in blocks of pixels and it does not. A method that cannot
  find a caustic looks noiseless; its scatter alone would recommend it. More passes make the scatter less, but what was
  never found in the probe will be missed, or a firefly, in the picture, too.

What the error of a path costs depends on the scene: connections on or off, how many, merging on or off are most of what
a user could set by hand. The choice is written into the picture's metadata, and kept when a run is resumed.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from etendue.core import RELATIVE_EPSILON, Measurement, Result, logger, setting
from etendue.scene import Problem, resized

from .base import FULL_LANES, ImageMethod, ImageSettings, Layer
from .bidirectional import Bpt, Vcm
from .path import Path

#: Pixels of the film that is probed, and side of the blocks in which missing light is looked for.
_PROBE_PIXELS = 128 * 128
_BLOCK = 4
#: What is chosen from, simplest first: name, method, settings.
CANDIDATES: dict[str, tuple[type[ImageMethod], dict[str, Any]]] = {
    "path": (Path, {}),
    "bpt": (Bpt, {}),
    "bpt with 6 connections": (Bpt, {"connections": 6, "shadow_roulette": 0.05}),
    "vcm": (Vcm, {}),
}
#: Passes of the probe's size that a picture is taken to have.
_PASSES = 64
#: A candidate must promise this much less than a simpler one.
_WORTH_IT = 0.9
#: A candidate with so many times the cost of the best is given up before the probe ends.
_HOPELESS = 3.0
#: A variant of a candidate, which is tried only where that one is still in the race after its first passes: kernels
#: take a second or two to compile.
_VARIANTS = {"bpt with 6 connections": "bpt"}


@dataclass(frozen=True)
class AutoSettings(ImageSettings):
    """Settings of ``auto``."""

    choice: str = setting("probe", "what renders: found by a probe, or given", choices=("probe", *CANDIDATES))
    probe_passes: int = setting(
        6, "passes that a candidate is probed with, if it is not given up before", minimum=2, maximum=1000
    )


class Auto(ImageMethod):
    """The method and the switches that a probe recommends."""

    name: ClassVar[str] = "auto"
    Settings: ClassVar[type[ImageSettings]] = AutoSettings
    citations: ClassVar[tuple[str, ...]] = (*Path.citations, *Vcm.citations)
    carries_on: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """The probe itself belongs to the first pass, so that a budget in seconds pays for it."""
        super().prepare(problem, seed)
        self._choice = self.settings.choice
        self._costs: dict[str, float] = {}
        self._chosen: ImageMethod | None = None
        self._carried: Mapping[str, Any] = {}  #: state for what was chosen, once it is prepared
        self.setup_seconds = 0.0  #: of the probe, which is a part of the first pass

    def step(self, iteration: int, seed: int) -> Measurement:
        """One pass of what was chosen."""
        return self._renderer(seed).step(iteration, seed)

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        return self._renderer(seed).render_pass(iteration, seed, samples)

    def develop(self, measurement: Measurement) -> Result:
        """Mean over the passes; the metadata say what was chosen and what the candidates' costs were."""
        result = super().develop(measurement)
        result.metadata |= {"chosen": self._choice, "probe": self._costs}
        return result

    def state(self) -> Mapping[str, Any]:
        """The choice, what it was made by, and the state of what was chosen."""
        chosen = self._carried if self._chosen is None else self._chosen.state()
        return {"choice": self._choice, "costs": self._costs, "chosen": chosen}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Inverse of :meth:`state`."""
        self._choice, self._costs, self._chosen = str(state["choice"]), dict(state["costs"]), None
        self._carried = state["chosen"]

    def _renderer(self, seed: int) -> ImageMethod:
        if self._chosen is None:
            if self._choice == "probe":
                begin = time.perf_counter()
                self._choice = self._probe(seed)
                self.setup_seconds = time.perf_counter() - begin
            self._chosen = self._method(self._choice, self.settings.samples_per_pass, self.settings.aovs)
            self._chosen.prepare(self.problem, seed)
            if self._carried:
                self._chosen.restore(self._carried)
        return self._chosen

    def _method(self, name: str, samples: int, aovs: bool) -> ImageMethod:
        cls, settings = CANDIDATES[name]
        common = {"max_depth": self.settings.max_depth, "sampler": self.settings.sampler}
        return cls(cls.Settings(samples_per_pass=samples, aovs=aovs, **common, **settings))

    # ------------------------------------------------------------------ the probe

    def _probe(self, seed: int) -> str:
        """Name of the candidate with the least time times error."""
        width, height = self.problem.size
        scale = min(1.0, (_PROBE_PIXELS / (width * height)) ** 0.5)
        small = resized(self.problem, (max(1, round(width * scale)), max(1, round(height * scale))))
        samples = max(1, FULL_LANES // (small.size[0] * small.size[1]))
        passes: dict[str, Measurement] = {}
        seconds: dict[str, float] = {}  # of a pass
        left: dict[str, ImageMethod] = {}

        def run(names: Iterable[str], until: int) -> None:
            """Bring candidates to so many passes, and give up those that are far behind."""
            for name in names:
                if name not in passes:
                    left[name] = self._method(name, samples, aovs=False)
                    left[name].prepare(small, seed)
                    passes[name], seconds[name] = left[name].step(0, seed), 0.0  # compiles, so it is not timed
                done = len(passes[name].iterations)
                begin = time.perf_counter()
                for iteration in range(done, until):
                    passes[name] += left[name].step(iteration, seed)
                seconds[name] = (seconds[name] * (done - 1) + time.perf_counter() - begin) / (until - 1)
            self._costs = costs(seconds, passes)
            least = min(self._costs[name] for name in left)
            for name in [name for name in left if self._costs[name] > _HOPELESS * least]:
                del left[name]

        run([name for name in CANDIDATES if name not in _VARIANTS], 2)
        run([name for name, base in _VARIANTS.items() if base in left], 2)
        until = 2
        while until < self.settings.probe_passes and len(left) > 1:
            until = min(2 * until, self.settings.probe_passes)
            run(list(left), until)
        chosen = choose({name: self._costs[name] for name in CANDIDATES if name in left})
        logger.info("auto: %s (cost %s)", chosen, ", ".join(f"{name} {c:.3g}" for name, c in self._costs.items()))
        return chosen


def costs(seconds: Mapping[str, float], passes: Mapping[str, Measurement]) -> dict[str, float]:
    """Seconds of a pass times the error of a picture of :data:`_PASSES` passes, by candidate."""
    pictures = {name: _blocks(m.mean()) for name, m in passes.items()}
    noise = {name: _blocks(m.variance_of_mean("image")) for name, m in passes.items()}
    # Relative to what most candidates see: a bright speck must not excuse itself by its own brightness.
    level = np.median(list(pictures.values()), axis=0)
    result = {}
    for name, measurement in passes.items():
        missed = np.zeros_like(level)
        for other in passes:
            # Beyond three standard errors: a lone bright sample of the other's is as uncertain as it is bright.
            doubt = 9.0 * (noise[name] + noise[other]) / _BLOCK**2
            gap = np.square(np.maximum(pictures[other] - pictures[name], 0.0)) - doubt
            missed = np.maximum(missed, gap / (np.square(pictures[other]) + RELATIVE_EPSILON))
        scatter = noise[name] / (np.square(level) + RELATIVE_EPSILON)
        error = scatter.mean() * len(measurement.iterations) / _PASSES + missed.mean()
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
