"""Base of the methods that make pictures by Markov chains."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import mitsuba as mi
import numpy as np

from etendue.core import (
    CONTRAST,
    Array,
    Carrying,
    CheckpointError,
    Iterations,
    Measurement,
    Record,
    Result,
    State,
    copied_to_device,
    free_memory,
    setting,
)
from etendue.film import COMPONENTS
from etendue.scene import Problem

from ..base import ImageMethod, ImageSettings, Layer
from .chains import IMAGES, ChainStates, PassResult, Progressed, Runner
from .film import BrightnessMap
from .targets import Contribution, Target

#: Most chains, and steps of a pass.
_MOST_CHAINS = 1 << 16
_STEPS = 8
#: Share of the memory that the bootstrap may take.
_BOOTSTRAP_SHARE = 0.25
#: Passes in which the steps are tuned.
TUNING = 16
#: Acceptance of small steps that tuning aims at, and the range of their size.
_ACCEPTED, _SIZES = 0.5, (2.0**-12, 0.25)
#: Numbers that chains carry on, beside arrays.
_PLAIN = ("unit", "cap", "steps", "large", "longest", "size", "share", "owed")
#: Least share of large steps: they tell the scale of the picture, whose error dominates where light is found rarely.
_LEAST_LARGE = 0.25


def halves_as_layers(pictures: Array) -> dict[str, Array]:
    """Layers of the mean pictures of two halves, (2, height, width, 3)."""
    return {"image": 0.5 * (pictures[0] + pictures[1]), "image" + CONTRAST: 0.5 * (pictures[0] - pictures[1])}


@dataclass(frozen=True)
class MetropolisSettings(ImageSettings):
    """Settings of the methods that make pictures by Markov chains."""

    chains: int = setting(
        0,
        "number of chains, rounded up to an even one; 0: chosen by the samples of a pass",
        minimum=0,
        maximum=1 << 20,
    )
    bootstrap: int = setting(
        1 << 18, "independent samples from which the first states of the chains are drawn, at least", minimum=2
    )
    large_steps: float = setting(
        0.0,
        "share of the steps that are independent of the chain; 0: tuned in the first passes",
        minimum=0.0,
        maximum=0.95,
    )
    step_size: float = setting(
        0.0,
        "largest distance of a small step, in units of a random number; 0: tuned in the first passes",
        minimum=0.0,
        maximum=1.0,
    )
    equalise: bool = setting(
        True,
        "divide the target of the chains by the brightness of a coarse picture, so that dark parts of the picture get "
        "as many samples as bright ones; false: samples in proportion to luminance",
    )
    vertices: int = setting(
        8, "surface points of a sub-path whose random numbers belong to the state of a chain", minimum=1, maximum=64
    )


class MetropolisMethod(Carrying, ImageMethod):
    """A picture by chains over the random numbers of paths. A subclass has :meth:`make_target`."""

    Settings: ClassVar[type[ImageSettings]] = MetropolisSettings
    settings: MetropolisSettings
    carries_on: ClassVar[bool] = True
    #: Whether replicas may run in other processes: states of chains do not come back from them yet.
    divides: ClassVar[bool] = False

    @abstractmethod
    def make_target(self, seed: int) -> Target:
        """The function of random numbers that the chains sample. The scene's tables are ready."""

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. Independent samples find the first states of the chains. Raises
        :class:`SceneError` if none of them finds light."""
        self._forget_states()
        super().prepare(problem, seed)
        s = self.settings
        paths = self.camera.pixels * self._samples(problem)
        chains = s.chains or min(_MOST_CHAINS, max(paths // _STEPS, 1))
        chains += chains % 2
        self._steps, self._chains = max(2, -(-paths // chains)), chains
        self.runner = Runner(
            self.make_target(seed),
            (self.camera.width, self.camera.height),
            chains,
            s.bootstrap,
            s.sampler,
            s.equalise,
            _BOOTSTRAP_SHARE * (problem.memory or free_memory() or math.inf),
        )
        self._carried = self.runner.start(seed)
        self._bootstrapped = float(self._carried.found[:, 0].sum())
        self._carried = replace(
            self._carried, size=s.step_size or self._carried.size, share=s.large_steps or self._carried.share
        )
        self._passes = 0

    @property
    def samples_per_iteration(self) -> int:
        """Paths per pixel of one pass: more than asked for where a step of all chains has more."""
        return max(1, round(self._steps * self._chains / self.camera.pixels))

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`."""
        return max(_MOST_CHAINS * 2 * _STEPS, super().full_lanes())

    # ------------------------------------------------------------------ a pass

    def _step(self, iteration: int, seed: int) -> Measurement:
        made = self._run(iteration, seed)
        self._tune(made)
        self._passes += 1
        layers, records = self._layers(iteration, seed, made)
        samples = self._steps * self._chains / self.camera.pixels
        sums = {name: layer * samples for name, layer in layers.items()}
        weights = dict.fromkeys(sums, samples)
        if self.settings.aovs:
            first, bad = self.first_layers(iteration, seed, self.samples_per_iteration)
            sums |= {name: layer.astype(np.float64) for name, layer in first.items()}
            weights |= dict.fromkeys(first, float(self.samples_per_iteration))
            made.counters["nonfinite"] += bad
        return Measurement(
            sums=sums,
            weights=weights,
            iterations=Iterations.single(iteration),
            counters=made.counters | {"samples": samples},
            records=records,
        )

    def _run(self, iteration: int, seed: int) -> PassResult:
        """Move the chains."""
        images = IMAGES * (len(COMPONENTS) if self.settings.components else 1)
        self._carried, made = self.runner.run(self._carried, self._steps, seed, self.splats(seed, iteration, images))
        return made

    def _layers(self, iteration: int, seed: int, made: PassResult) -> tuple[dict[str, Array], dict[str, Record]]:
        """(mean picture of a pass and its contrast, records) of what the chains have splatted."""
        assert made.pictures is not None and made.parts is not None
        layers = halves_as_layers(made.pictures)
        if self.settings.components:
            layers |= zip(COMPONENTS, made.parts.mean(axis=1), strict=True)
        return layers, {}

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """Not used: a pass is :meth:`_step`."""
        raise NotImplementedError

    def _tune(self, made: PassResult) -> None:
        """Adapt the steps by the acceptance of a pass, in the first passes of a run. The target remains the
        distribution of the chains under steps of any size that do not depend on a chain's own path."""
        s, c, counts = self.settings, self._carried, made.counters
        if self._passes >= TUNING:
            return
        size, share = c.size, c.share
        if not s.step_size and counts["small steps"]:
            accepted = counts["small steps accepted"] / counts["small steps"]
            size = float(np.clip(size * np.clip(accepted / _ACCEPTED, 0.5, 2.0), *_SIZES))
        if not s.large_steps and counts["large steps"]:
            accepted = counts["large steps accepted"] / counts["large steps"]
            share = float(np.clip(accepted, _LEAST_LARGE, 0.75))
        self._carried = replace(c, size=size, share=share)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """See :class:`ImageMethod`; the metadata tell how the chains move, and the mean luminance of the independent
        samples with its standard error."""
        result = super().develop(measurement, state)
        result.metadata["chains"] = self.facts(measurement, state)
        return result

    def facts(self, measurement: Measurement, state: State) -> dict[str, Any]:
        """Plain facts about the chains of a measurement."""
        count, target, bright, squares, target_squares = np.asarray(state["found"]).sum(0)
        variance = max(squares / count - (bright / count) ** 2, 0.0)
        spread = max(target_squares * count / target**2 - 1.0, 0.0)
        c = measurement.counters
        return {
            "number": self.runner.chains,
            "steps": int(state["steps"]),
            "longest_stay": int(state["longest"]),
            "step_size": float(state["size"]),
            "large_steps": c["large steps"] / (c["large steps"] + c["small steps"]),
            "accepted_small": c["small steps accepted"] / max(c["small steps"], 1.0),
            "accepted_large": c["large steps accepted"] / max(c["large steps"], 1.0),
            "mean_luminance": float(bright / count),
            "mean_luminance_error": float(np.sqrt(variance / count)),
            "startup_bias": float((1.0 + spread) / self._bootstrapped),
        }

    # ------------------------------------------------------------------ state

    def _left(self) -> State:
        c = self._carried
        return {
            "numbers": dict(c.states.numbers),
            "places": [[one.position.x, one.position.y] for one in c.states.contributions],
            "values": [[one.value.x, one.value.y, one.value.z] for one in c.states.contributions],
            "target": c.states.target,
            "rejected": c.states.rejected,
            "factors": c.factors.values,
            "found": c.found,
            "passes": self._passes,
            **{name: getattr(c, name) for name in _PLAIN},
        }

    def _take(self, state: State) -> None:
        target, chains = self.runner.target, self.runner.chains
        rows = {name: layout.size * chains for name, layout in target.layouts.items()}
        numbers = {name: np.asarray(values) for name, values in state["numbers"].items()}
        contributions = len(self._carried.states.contributions)
        found = np.asarray(state["found"], np.float64)
        fits = {k: v.size for k, v in numbers.items()} == rows and len(state["values"]) == contributions
        if not fits or found.shape != self._carried.found.shape:
            raise CheckpointError("the chains in the checkpoint do not fit this picture and these settings; start anew")

        def floats(values: Any) -> list[mi.Float]:
            return [copied_to_device(mi.Float, np.asarray(v)) for v in values]

        states = ChainStates(
            {name: copied_to_device(mi.Float, values) for name, values in numbers.items()},
            [
                Contribution(mi.Point2f(*floats(place)), mi.Color3f(*floats(value)), one.component)
                for place, value, one in zip(
                    state["places"], state["values"], self._carried.states.contributions, strict=True
                )
            ],
            floats([state["target"]])[0],
            copied_to_device(mi.UInt32, np.asarray(state["rejected"])),
        )
        self._passes = int(state["passes"])
        self._carried = Progressed(
            states,
            BrightnessMap(np.asarray(state["factors"], np.float32), (self.camera.width, self.camera.height)),
            found=found,
            unit=float(state["unit"]),
            cap=float(state["cap"]),
            size=float(state["size"]),
            share=float(state["share"]),
            owed=float(state["owed"]),
            steps=int(state["steps"]),
            large=int(state["large"]),
            longest=int(state["longest"]),
        )
