"""Base of the methods that make pictures by Markov chains."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import drjit as dr
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
    UnsupportedError,
    Weight,
    copied_to_device,
    free_memory,
    logger,
    setting,
)
from etendue.film import COMPONENTS
from etendue.scene import Problem, is_spectral

from ..base import ImageMethod, ImageSettings, Layer
from ..bidirectional import Bpt
from ..path import Path
from .blend import Beside, Blend, Grid
from .chains import Chains, bootstrap_within
from .states import BrightnessMap, ChainStates, PassResult, Progressed
from .targets import Contribution, Target
from .walk import IMAGES

#: Most chains, on a GPU and on a CPU: fewer keep the cores of a CPU busy, and each makes more steps in the same time;
#: and least steps of a pass.
_MOST_CHAINS, _MOST_CPU_CHAINS = 1 << 16, 1 << 15
_STEPS = 8
#: Most samples of the bootstrap that is not given, and share of the memory that it may take.
_BOOTSTRAP = 1 << 18
_BOOTSTRAP_SHARE = 0.25
#: Passes in which the steps are tuned.
TUNING = 16
#: Acceptance of small steps that tuning aims at, and the range of their size.
_ACCEPTED, _SIZES = 0.5, (2.0**-12, 0.25)
#: Numbers that chains carry on, beside arrays.
_PLAIN = ("unit", "cap", "steps", "large", "longest", "size", "share", "owed")
#: Least share of large steps, which bring chains to light that they have not found yet.
_LEAST_LARGE = 0.25
#: Effective number of samples of the bootstrap below which there is a warning.
_FEW = 100
#: Camera paths of the independent estimator for each half, to steps of chains in the first pass.
_BESIDE = 0.25
#: Least and largest share of the work of a pass for chains, and cost of a ray of chains relative to a ray of the
#: independent estimator.
_SHARES, _RAY = (0.25, 0.8), 1.5
#: Most steps of a pass, relative to the first.
_LONGEST = 16


def beside_paths(method: ImageMethod) -> type[ImageMethod]:
    """The estimator beside chains over camera paths: ``bpt``, but ``path`` where directions are not sampled by
    materials, and in scenes with light that these chains do not find: that of beams, and through mirrors and glass that
    of lights that no ray can hit."""
    lights = method.lights
    return Path if lights.has_delta or lights.has_beam or not method.settings.bsdf_sampling else Bpt


def halves_as_layers(pictures: Array, name: str = "image") -> dict[str, Array]:
    """Layers of the mean pictures of two halves, (2, height, width, 3)."""
    return {name: 0.5 * (pictures[0] + pictures[1]), name + CONTRAST: 0.5 * (pictures[0] - pictures[1])}


@dataclass(frozen=True)
class MetropolisSettings(ImageSettings):
    """Settings of the methods that make pictures by Markov chains."""

    chains: int = setting(
        0,
        "number of chains, rounded up to a multiple of four; 0: chosen by the samples of a pass",
        minimum=0,
        maximum=1 << 20,
    )
    bootstrap: int = setting(
        0,
        "independent samples from which the first states of the chains are drawn, at least; 0: as many as the first "
        "pass has paths, up to 262144",
        minimum=0,
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
    spectral: ClassVar[bool] = True
    renders_bands: ClassVar[bool] = False  # chains have wavelengths of their own
    in_the_dark: ClassVar[type[ImageMethod] | None] = Bpt  # chains cannot start without light

    @abstractmethod
    def make_target(self, seed: int) -> Target:
        """The function of random numbers that the chains sample. The scene's tables are ready."""

    def beside(self) -> type[ImageMethod]:
        """The independent estimator that determines the scale of the picture. It finds the light that chains find, and
        no other."""
        return Bpt

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. Independent samples find the first states of the chains. Raises
        :class:`SceneError` if none of them finds light."""
        self._forget_states()
        super().prepare(problem, seed)
        if is_spectral() and self.visibility.media is not None:
            raise UnsupportedError(
                f"method '{self.name}' renders no media under {mi.variant()}; use vcm, bpt or path, or llvm_ad_rgb"
            )
        s = self.settings
        samples = self.samples_for(problem)
        paths = self.camera.pixels * samples
        is_cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        most = _MOST_CPU_CHAINS if is_cpu else _MOST_CHAINS
        chains = s.chains or min(most, max(paths // _STEPS, 1))
        chains += -chains % 4
        self._steps, self._chains = max(2, -(-paths // chains)), chains
        self.runner = Chains(
            self.make_target(seed),
            (self.camera.width, self.camera.height),
            chains,
            s.bootstrap or min(_BOOTSTRAP, bootstrap_within(paths, s.equalise)),
            s.sampler,
            s.equalise,
            _BOOTSTRAP_SHARE * (problem.memory or free_memory() or math.inf),
            usual=s.bootstrap or _BOOTSTRAP,
        )
        self._carried = self.runner.start(seed)
        count, target, squares = self._carried.found.sum(axis=0)
        self._bootstrapped = float(count)
        if target**2 < _FEW * squares:
            logger.warning(
                "few paths find light: the picture and its brightness depend on about %d of the %d samples of the "
                "bootstrap; raise bootstrap, and do not rely on the reported error",
                max(1, round(target**2 / squares)),
                count,
            )
        self._carried = replace(
            self._carried, size=s.step_size or self._carried.size, share=s.large_steps or self._carried.share
        )
        self._passes = 0
        kind = self.beside()
        shared = (
            "max_depth",
            "hide_emitters",
            "sampler",
            "scrambling",
            "reconstruction",
            "components",
            "bsdf_sampling",
        )
        known = kind.Settings.names()
        same = {name: getattr(s, name) for name in shared if name in known and hasattr(s, name)}
        if "guide_emission" in known:
            same["guide_emission"] = "off"  # its passes do not depend on each other
        independent = kind(kind.Settings(samples_per_pass=max(1, round(_BESIDE * samples)), **same))
        independent.prepare(problem, seed)
        self._parts = COMPONENTS if s.components else ("image",)
        self._beside = Beside(independent, self._parts)
        self._besides = self._beside.start()
        self._begin_blend()

    def _begin_blend(self) -> None:
        """The picture before the first pass."""
        self._grid = Grid(self.camera.width, self.camera.height)
        self._blend = Blend.empty(self.camera.width, self.camera.height, len(self._parts))
        self._work = (0.0, 0.0)  # rays: of a step, and of the independent estimator in a pass
        self._planned = self._steps  # steps of a pass

    def bind(self, scene: mi.Scene | None) -> None:
        """See :class:`ImageMethod`."""
        super().bind(scene)
        self._beside.method.bind(scene)
        self.runner.release()

    @property
    def samples_per_iteration(self) -> int:
        """Paths per pixel of one pass: more than asked for where a step of all chains has more."""
        return max(1, round(self._steps * self._chains / self.camera.pixels))

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`."""
        return max(_MOST_CHAINS * 2 * _STEPS, super().full_lanes())

    # ------------------------------------------------------------------ a pass

    def _step(self, iteration: int, seed: int) -> Measurement:
        self.take_wavelengths(iteration, seed)  # of the layers of first hits; chains have their own
        self._planned = steps = self._plan()
        made = self._run(iteration, seed, steps)
        independent, self._besides, counts = self._beside.step(iteration, seed, self._besides)
        self._work = made.counters["rays"] / steps, counts["rays"]
        for name in counts:
            made.counters[name] += counts[name]
        self._tune(made)
        self._passes += 1
        pictures, records = self._pictures(iteration, seed, made, independent, steps)
        samples = float(self.samples_per_iteration)
        layers = halves_as_layers(pictures.sum(axis=0))
        if self.settings.components:
            for name, halves in zip(COMPONENTS, pictures, strict=True):
                parts = halves_as_layers(halves, name)
                layers |= parts if self.settings.aovs else {name: parts[name]}
        sums = {name: layer * samples for name, layer in layers.items()}
        weights: dict[str, Weight] = dict.fromkeys(sums, samples)
        if self.settings.aovs:
            first, bad = self.first_layers(iteration, seed, self.samples_per_iteration)
            sums |= {name: layer.astype(np.float64) for name, layer in first.items()}
            weights |= {name: self._weight_of(name, self.samples_per_iteration) for name in first}
            made.counters["nonfinite"] += bad
        return Measurement(
            sums=sums,
            weights=weights,
            iterations=Iterations.single(iteration),
            counters=made.counters | {"samples": samples},
            records=records,
        )

    def _plan(self) -> int:
        """Steps of the next pass: where chains have less variance for their work than the independent estimator, they
        have the larger share of the work. The number of steps is tuned in the first passes only, as their size is:
        otherwise it would depend on where the chains are, which would bias their mean picture."""
        if not 0 < self._passes < TUNING:
            return self._planned
        by_chains, by_paths = (v.mean() for v in self._blend.variances(self._grid))
        step, paths = _RAY * self._work[0], self._work[1]
        chains, other = (by_paths * paths) ** 2, (by_chains * step) ** 2
        share = float(np.clip(chains / (chains + other), *_SHARES)) if chains + other > 0.0 else 0.5
        return max(2, min(round(share / (1.0 - share) * paths / step), _LONGEST * self._steps))

    def _run(self, iteration: int, seed: int, steps: int) -> PassResult:
        """Move the chains."""
        splats = self.splats(seed, iteration, IMAGES * len(self._parts))
        self._carried, made = self.runner.run(self._carried, steps, seed, splats)
        return made

    def _pictures(
        self, iteration: int, seed: int, made: PassResult, independent: Array, steps: int
    ) -> tuple[Array, dict[str, Record]]:
        """(contribution of a pass to the picture, (parts, 2, height, width, 3); records). ``independent``: the picture
        beside the chains."""
        weights = self._blend.weights(self._grid, steps)
        factors = self._carried.factors.of_pixels
        self._blend, added = self._blend.after(made, independent, weights, factors, steps)
        return added, {}

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
        """See :class:`ImageMethod`; the metadata contain facts about the chains, and the mean luminance of the
        independent estimator with its standard error."""
        result = super().develop(measurement, state)
        result.metadata["chains"] = self.facts(measurement, state)
        return result

    def facts(self, measurement: Measurement, state: State) -> dict[str, Any]:
        """Plain facts about the chains of a measurement."""
        count, target, squares = np.asarray(state["found"]).sum(0)
        spread = max(squares * count / target**2 - 1.0, 0.0)
        mean, error = Blend.of(state["blend"]).scale.luminance()
        c = measurement.counters
        return {
            "number": self.runner.chains,
            "steps": int(state["steps"]),
            "longest_stay": int(state["longest"]),
            "step_size": float(state["size"]),
            "large_steps": c["large steps"] / (c["large steps"] + c["small steps"]),
            "accepted_small": c["small steps accepted"] / max(c["small steps"], 1.0),
            "accepted_large": c["large steps accepted"] / max(c["large steps"], 1.0),
            "mean_luminance": mean,
            "mean_luminance_error": error,
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
            "work": list(self._work),
            "planned": self._planned,
            "beside": list(self._besides),
            "blend": self._blend.left(),
            **{name: getattr(c, name) for name in _PLAIN},
        }

    def _take(self, state: State) -> None:
        target, chains = self.runner.target, self.runner.chains
        rows = {name: layout.size * chains for name, layout in target.layouts.items()}
        numbers = {name: np.asarray(values) for name, values in state["numbers"].items()}
        contributions = len(self._carried.states.contributions)
        found, blend = np.asarray(state["found"], np.float64), Blend.of(state.get("blend", {}))
        fits = {k: v.size for k, v in numbers.items()} == rows and len(state["values"]) == contributions
        if not fits or found.shape != self._carried.found.shape or blend.shapes != self._blend.shapes:
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
        self._passes, self._blend = int(state["passes"]), blend
        self._work, self._besides = tuple(state["work"]), list(state["beside"])
        self._planned = int(state["planned"])
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
