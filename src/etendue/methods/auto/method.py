r"""``vcm`` that chooses its sample counts while it renders: light paths per camera path, connections, merging or not.

The first passes have many techniques, and estimate what the second moment of the picture would be for each of the
:data:`CANDIDATES` (:class:`etendue.transport.Moments`). The counts whose product of error and cost is least
(:mod:`.efficiency`) render the following passes. Without light paths a pass is one of ``path``. Estimates and decision
are repeated during the run, at a bounded share of its cost, because light that is found late changes them.

If passes merge, some take turns with a larger radius, and the radius of the following ones is that of the least error
(:mod:`.widening`).

All passes are part of the picture, with equal weights: each is an estimate of the picture, whatever earlier passes have
found. Passes with merging have a bias, which vanishes as the radius shrinks.

Nothing is learned in a run that is too short for it, in seconds or in samples. Light of a sun through windows or on
mirrors and glass (:mod:`..openings`), caustics of lamps, and scenes where a few paths from the camera are noisy
(:mod:`.noise`), are then rendered by ``vcm`` if there are mirrors or glass, by ``bpt`` if not, all others by ``path``.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import (
    Carrying,
    CheckpointError,
    Measurement,
    Result,
    SampleSource,
    State,
    logger,
    own_kernels,
    setting,
)
from etendue.film import COMPONENTS
from etendue.scene import LightTable, Problem, materials, one_way, refuse_one_way
from etendue.transport import CameraPath, CameraWalk, Candidate, DirectWeights, FirstHits, Moments, Walker

from .. import radius as radii
from ..base import REWEIGHT, CameraSettings, ImageMethod, Layer
from ..bidirectional import BidirectionalSettings, Vcm
from ..openings import PREVIEW, OpeningSettings, camera_paths_of, is_short, through_openings
from ..path import Path, Trace, camera_paths, path_pass, traced
from .efficiency import LEARNING, PHOTON, Learned, PassWork, tile_pixels
from .noise import noise_of_paths
from .widening import Trial

#: Counts of the passes that estimate moments.
LEARNER = Candidate(1.0, 2, True)
_NONE = Candidate(0.0, 0, False)
#: The counts to choose from. Around the best ones the product of error and cost is flat: a finer table would gain some
#: per cent, and each candidate makes the kernels of passes that learn larger.
CANDIDATES: tuple[Candidate, ...] = (
    _NONE,
    *(Candidate(n, k, False) for n, k in itertools.product((0.125, 0.5), (0, 1, 2, 4, 8))),
    *(Candidate(n, k, True) for n, k in itertools.product((0.125, 0.5), (0, 1, 2, 4))),
    Candidate(1.0, 0, True),
    Candidate(1.0, 1, True),
    Candidate(2.0, 1, True),
)
#: Counts that a user may choose.
FIXED: dict[str, Candidate] = {
    "path": _NONE,
    "bpt": Candidate(0.5, 2, False),
    "bpt with 6 connections": Candidate(0.5, 6, False),
    "vcm": Candidate(0.5, 1, True),
}
#: Seconds of a run below which nothing is learned, and seconds more for each kind of material, which all make kernels
#: larger, and may have to be compiled. At 10 s, learning gains most in rooms lit from other rooms, and loses up to half
#: as much again where caustics are all of the light.
_LEAST, _PER_KIND = 5.0, 1.0
#: The same of a run below which no light paths are traced if ``path`` finds all light, too; and seconds more where that
#: depends on the noise of path tracing, which takes kernels as well.
_HASTY, _HASTY_PER_KIND, _TESTING = 0.2, 0.33, 0.5
#: Noise of path tracing above which light paths pay.
_NOISY = 5.0
#: Share of a run's cost for passes that learn, after the first ones.
_SHARE = 0.06
#: Least ratio of products of error and cost at which the counts stay as they are.
_WORTH_IT = 0.93
#: Ratio of products of error and cost up to which two candidates count as equal: few passes estimate them.
_ALIKE = 1.05
#: If caustics are expected, products of candidates without light paths, and without merging, are multiplied by 1 plus
#: this number over the number of passes that have learned: these may all have missed a small caustic.
_DOUBT = {"path": 1.0, "bpt": 0.4}


@dataclass(frozen=True)
class AutoSettings(OpeningSettings, CameraSettings):
    """Settings of ``auto``."""

    rr_depth: int = setting(
        5,
        "path length, in edges, from which on Russian roulette may end a path; values above 2 act as 2, except with "
        "choice=path",
        minimum=1,
    )
    reweight: bool = setting(True, REWEIGHT)
    choice: str = setting(
        "learn",
        "sample counts of the passes: chosen while it renders (learn), or those of path, bpt, bpt with "
        "6 connections, or vcm",
        choices=("learn", *FIXED),
    )
    probe_passes: int = setting(
        2, "number of passes before the first choice; more: a better choice", minimum=1, maximum=1000
    )
    radius: float = setting(
        0.0, f"merge radius of the first pass, in the unit of radius_unit; {radii.RADIUS_DOC}", minimum=0.0
    )
    radius_unit: str = setting("scene", radii.UNIT_DOC, choices=radii.UNITS)
    alpha: float = setting(
        0.75,
        "reduction of the merge radius: after m camera paths per pixel it is radius * (m + 1)^((alpha - 1) / 2); "
        "1: constant",
        above=0.0,
        maximum=1.0,
    )

    @property
    def samples_sky(self) -> bool:
        """See :class:`OpeningSettings`."""
        return True


class Auto(Carrying, ImageMethod):
    """Vertex connection and merging with sample counts that are chosen while it renders."""

    name: ClassVar[str] = "auto"
    Settings: ClassVar[type[CameraSettings]] = AutoSettings
    settings: AutoSettings
    citations: ClassVar[tuple[str, ...]] = ("Grittmann2022", "Su2022", "Zirr2018", *Path.citations, *Vcm.citations)
    carries_on: ClassVar[bool] = True
    media: ClassVar[str | None] = "scattering"
    spectral: ClassVar[bool] = True
    one_way = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. The first pass with light paths prepares what only such passes need."""
        self._forget_states()
        self._vcm: Vcm | None = None
        super().prepare(problem, seed)
        self._seed = seed
        self._opened: LightTable | None = None
        self._vcm_state: State = {}
        self._choice = self.settings.choice
        if one_way(problem.scene) is not None:
            if self._choice in FIXED and self._choice != "path":
                refuse_one_way(problem.scene, f"choice={self._choice}")
            self._choice = "path"
        self._counts = FIXED.get(self._choice, LEARNER)
        self._learned = Learned.none()
        self._trial = Trial.none()
        self._products: dict[str, float] = {}
        self._spent = self._spent_learning = 0.0
        self._caustics = self._has_specular() and (self.lights.has_area or self.lights.has_delta)
        self.plan(None, None, None)

    def bind(self, scene: mi.Scene | None) -> None:
        """See :class:`ImageMethod`."""
        super().bind(scene)
        if self._vcm:
            self._vcm.bind(scene)

    def take_wavelengths(self, iteration: int, seed: int) -> None:
        """See :class:`ImageMethod`; also for the estimator, whose lights may be those of other passes."""
        super().take_wavelengths(iteration, seed)
        self._wavelengths_of = iteration, seed
        if self._vcm:
            self._vcm.take_wavelengths(iteration, seed)

    _wavelengths_of = 0, 0  #: iteration and seed of the pass

    def plan(self, seconds: float | None, passes: int | None, error: float | None) -> None:
        """See :class:`Method`."""
        self._short = is_short(self, seconds, passes)
        if camera_paths_of(self, passes) <= PREVIEW:
            seconds = 0.0  # the kernels would take longer than the passes
        self._brief = self._without_learning(seconds)

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`. Passes of path tracing are as small as those that merge."""
        return super().full_lanes() // 2

    # ------------------------------------------------------------------ passes

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        if self._brief and self._counts == LEARNER and not self._learned.passes:
            self._counts = self._brief
        learning = self._learns and self._is_due()
        if learning:
            rendered = self._learn(iteration, seed, samples)
        elif self._counts.merging and self._learned.passes and not self.settings.radius:
            rendered = self._widened(iteration, seed, samples)
        else:
            rendered = self._rendered(self._counts, iteration, seed, samples)
        cost = self._work().cost(LEARNER) * LEARNING if learning else self._work().cost(self._counts)
        self._spent += cost
        self._spent_learning += cost if learning else 0.0
        return rendered

    def render_with(self, counts: Candidate, iteration: int, seed: int) -> np.ndarray:
        """A pass with given counts, apart from the run: its picture (height, width), means over the channels."""
        samples = self.samples_per_iteration
        layers, _ = self._rendered(counts, iteration, seed, samples)
        return np.asarray(layers["image"].mean(axis=2, dtype=np.float64) / samples)

    def foreseen(self, counts: Candidate) -> float:
        """Product of error and cost of one of the :data:`CANDIDATES`, after a pass that has learned."""
        return float(self._learned.errors()[CANDIDATES.index(counts)]) * self._work().cost(counts)

    @property
    def _learns(self) -> bool:
        """Whether passes of this run may learn."""
        return self._choice not in FIXED and (self._brief is None or self._learned.passes > 0)

    def _is_due(self) -> bool:
        """Whether the next pass learns."""
        if self._learned.passes < self.settings.probe_passes:
            return True
        cost = self._work().cost(LEARNER) * LEARNING
        return self._spent_learning + cost <= _SHARE * self._spent

    def _work(self) -> PassWork:
        return self._learned.mean_work()

    def _estimator(self) -> Vcm:
        """The prepared estimator of passes with light paths."""
        counts = LEARNER if self._learns else self._counts
        if self._vcm is None or (counts.merging and not self._vcm.settings.merging):
            if self._vcm:
                self._vcm_state = self._vcm.left()
            own = self.settings
            names = ("max_depth", "hide_emitters", "sampler", "scrambling", "reconstruction", "clamp", "components")
            common = {name: getattr(own, name) for name in names} | {"samples_per_pass": self.samples_per_iteration}
            settings = BidirectionalSettings(
                **common,
                rr_depth=self._rr_depth,
                radius=own.radius,
                radius_unit=own.radius_unit,
                alpha=own.alpha,
                light_paths=counts.light_paths,
                connections=counts.connections,
                merging=counts.merging,
                guide_connections=self._learns,
                shadow_roulette=0.05 if counts.connections > 2 else BidirectionalSettings.shadow_roulette,
            )
            begin = time.perf_counter()
            vcm = Vcm(settings)
            vcm.opened = self._through_openings()
            if own.choice not in FIXED:
                most = max(candidate.light_paths for candidate in CANDIDATES)
                vcm.light_stride = round(most * self.camera.pixels * self.samples_per_iteration)
            vcm.moments = self._moments() if self._learns else None
            vcm.prepare(self.problem, self._seed)
            vcm.moments = None
            self.setup_seconds = time.perf_counter() - begin
            self._vcm_first = vcm.start()
            vcm.enter(self._state_of_vcm())
            vcm.take_wavelengths(*self._wavelengths_of)
            self._vcm = vcm
        self._vcm.recording = self.recording
        return self._vcm

    def _through_openings(self) -> LightTable:
        """The lights with their openings, which short runs may not need."""
        if self._opened is None:
            super().take_wavelengths(0, self._seed)  # the same whenever they are found
            self._opened = through_openings(self, self._seed)
            super().take_wavelengths(*self._wavelengths_of)
        return self._opened

    @property
    def _rr_depth(self) -> int:
        """Path length from which on Russian roulette may end a path, in passes whose counts are not fixed."""
        return min(self.settings.rr_depth, BidirectionalSettings.rr_depth)

    def _widened(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """A pass that merges, with the radius or a larger one."""
        work, counts = self._work(), self._counts
        if self._trial.begins:
            self._trial = self._trial.begun(counts.light_paths * work.photons / max(work.smooth, 1e-9))
        layers, counters = self._rendered(counts, iteration, seed, samples, self._trial.next)
        if self._trial.runs:
            merging = PHOTON * counts.light_paths * work.photons
            self._trial = self._trial.after(
                self._picture(layers, samples), np.array([work.cost(counts) - merging, merging])
            )
            if not self._trial.runs:
                logger.info("auto: the merge radius is multiplied by %.3g", self._trial.factor)
        return layers, counters

    def _picture(self, layers: Mapping[str, Layer], samples: int) -> np.ndarray:
        """The picture of a pass, (height, width), means over the channels."""
        parts = [layers[name] for name in (COMPONENTS if self.settings.components else ("image",))]
        return np.asarray(np.sum(parts, axis=0).mean(axis=2, dtype=np.float64) / samples)

    def _rendered(
        self, counts: Candidate, iteration: int, seed: int, samples: int, widening: float = 0.0
    ) -> tuple[dict[str, Layer], dict[str, float]]:
        """A pass with given counts; ``widening``: factor on the radius, 0 for that of the trial."""
        if counts.light_paths == 0.0:
            return path_pass(self, iteration, seed, samples, self._tracing())
        vcm = self._estimator()
        vcm.use(counts)
        vcm.widening = widening or self._trial.factor
        vcm._hits = self._hits
        return vcm.render_pass(iteration, seed, samples)

    def _tracing(self, lights: LightTable | None = None) -> Trace:
        """The function that traces the paths of passes without light paths, from their lights or others."""
        lights = lights or self._lights_of_paths()
        # Roulette as in the passes that predict the error; with fixed counts, as in the method ``path``.
        own: dict[str, Any] = {}
        if self._choice not in FIXED:
            own = {"rr_depth": self._rr_depth, "survival": CameraWalk.survival}

        def trace(ray: mi.Ray3f, source: SampleSource, first: FirstHits | None) -> CameraPath:
            walker = self.walker(Walker, lights=lights, first=first, **own)
            return traced(ray, walker, DirectWeights(), source, **self.path_fields())

        return trace

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`; with the counts of the next pass."""
        if self._counts.light_paths == 0.0:
            dr.eval(camera_paths(self, lanes, iteration, seed, samples, self._tracing()).radiance)
            return
        vcm = self._estimator()
        vcm.use(self._counts)
        vcm.trace_through(lanes, samples, iteration, seed)

    def trace_from_lights(self, number: mi.UInt32, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        self._estimator().trace_from_lights(number, iteration, seed)

    def _lights_of_paths(self) -> LightTable:
        """The lights for path tracing, with the probabilities of the passes that predict its error."""
        if self._vcm is None and "emission" not in self._vcm_state:
            return self.lights if self._short and not self._learned.passes else self._through_openings()
        return self._estimator().sampled_lights

    # ------------------------------------------------------------------ learning

    @own_kernels(optimise=False)  # few passes
    def _learn(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """A pass that estimates moments, and the decision after it."""
        vcm = self._estimator()
        generation = vcm.generation
        camera_paths = self.camera.pixels * samples
        light_paths = LEARNER.light_paths * camera_paths
        vcm.moments = self._moments()
        try:
            layers, counters = self._rendered(LEARNER, iteration, seed, samples)
            edges, smooth, photons = vcm.moments.walked() / camera_paths
            work = edges, smooth, photons / LEARNER.light_paths, counters["light_vertices"] / light_paths
            width, height = self.problem.size
            tiles = vcm.moments.tiles() / (tile_pixels(height, width) * samples)[..., None, None]
        finally:
            vcm.moments = None
        picture = self._picture(layers, samples)
        if np.isfinite(tiles).all() and np.isfinite(picture).all():
            self._learned = self._learned.after(tiles, picture, work, generation)
        self._decide()
        return layers, counters

    def _moments(self) -> Moments:
        """Estimates of the moments of a pass."""
        light_paths = LEARNER.light_paths * self.camera.pixels  # of a pass, over camera paths of a pixel
        # A photon is merged by several camera paths of a pixel, and of its neighbours: the noise of merges is not
        # filtered as that of camera paths is. The root fits passes of 1 to 4 camera paths per pixel.
        discount, noise = BidirectionalSettings.eta_discount, math.sqrt(self.samples_per_iteration)
        return Moments(CANDIDATES, LEARNER, self.problem.size, 1.0 / light_paths, discount, noise)

    def _decide(self) -> None:
        """Choose the counts of the next passes."""
        if not self._learned.passes:
            return
        work = self._work()
        products = {c: float(e) * work.cost(c) for c, e in zip(CANDIDATES, self._learned.errors(), strict=True)}
        if self._caustics:
            for candidate in products:
                kind = "path" if candidate.light_paths == 0.0 else "bpt"
                if not candidate.merging:
                    products[candidate] *= 1.0 + _DOUBT[kind] / self._learned.passes
        best = min(products, key=lambda c: products[c])
        # Rare bright paths, which two passes may find or not, add the same error to all candidates, so that cheap ones
        # look better than they are: one connection is made even if its product is a little larger than without.
        connected = replace(best, connections=1)
        if best.connections == 0 and products.get(connected, math.inf) <= _ALIKE * products[best]:
            best = connected
        now = products.get(self._counts)
        if now is None or self._learned.passes <= self.settings.probe_passes or products[best] < _WORTH_IT * now:
            self._counts = best
        least = max(products[best], 1e-30)
        told = {c: p / least for c, p in products.items() if c in (_NONE, LEARNER) or p < 1.3 * least}
        self._products = {describe(c): round(p, 3) for c, p in told.items()}
        logger.info("auto: %s", describe(self._counts))

    # ------------------------------------------------------------------ state

    def develop(self, measurement: Measurement, state: State) -> Result:
        """Mean over the passes; the metadata contain the counts of the next pass, and the products of error and cost
        of the best candidates, relative to the least."""
        result = super().develop(measurement, state)
        facts = dict(self._vcm.notes) if self._vcm else {}
        if "merge_radius" in facts:
            factor = Trial.of(state["widening"]).factor
            facts["merge_radius"] = {name: float(f"{r * factor:.4g}") for name, r in facts["merge_radius"].items()}
        result.metadata |= facts | {
            "chosen": describe(Candidate(*state["counts"])),
            "products": dict(state["products"]),
        }
        return result

    def _left(self) -> State:
        """The counts, what has been learned, and the state of the estimator."""
        counts = self._counts
        return {
            "counts": [counts.light_paths, counts.connections, counts.merging],
            "learned": self._learned.state(),
            "widening": self._trial.state(),
            "products": self._products,
            "spent": [self._spent, self._spent_learning],
            "vcm": self._vcm.left() if self._vcm else self._vcm_state,
        }

    def _take(self, state: State) -> None:
        try:
            paths, connections, merging = state["counts"]
            learned, trial = Learned.of(state["learned"]), Trial.of(state["widening"])
        except (KeyError, TypeError, ValueError):
            raise CheckpointError("the checkpoint is of another version of auto; start a new run") from None
        height, width = self.problem.size[::-1]
        if learned.passes and learned.picture.shape != (height, width):
            raise CheckpointError("what auto has learned is of another picture; start a new run")
        self._counts = Candidate(float(paths), int(connections), bool(merging))
        self._learned, self._trial, self._products = learned, trial, dict(state["products"])
        self._spent, self._spent_learning = (float(value) for value in state["spent"])
        self._vcm_state = state["vcm"]
        if self._vcm:
            self._vcm.enter(self._state_of_vcm())

    def _state_of_vcm(self) -> State:
        """The state of the estimator. Entries that passes have not left are those after its preparation: a run that was
        too short to learn leaves none of connections. A new object, so that it is always loaded: a failed pass may have
        changed the learned densities."""
        return {**self._vcm_first, **self._vcm_state}

    # ------------------------------------------------------------------ the scene

    def _without_learning(self, seconds: float | None) -> Candidate | None:
        """Counts for a run that is too short to learn."""
        kinds = len({m.class_name() for m in materials(self.scene) if isinstance(m, mi.BSDF)})
        if seconds is None or seconds >= _LEAST + _PER_KIND * kinds or self._choice in FIXED:
            return None
        is_specular = self._has_specular()
        counts = FIXED["vcm" if is_specular or not self.camera.can_splat else "bpt"]
        if self.lights.has_beam or (self.lights.has_sun and self._through_openings().lines is not None):
            return counts
        if is_specular and self.lights.has_delta:
            return counts  # for caustics that paths from the camera never find
        spare = seconds - _HASTY - _HASTY_PER_KIND * kinds
        if spare < 0.0 or not self.lights.has_area:
            return _NONE
        return counts if is_specular or (spare >= _TESTING and self._noise() > _NOISY) else _NONE

    def _noise(self) -> float:
        """The noise of passes of path tracing."""
        noise = noise_of_paths(self, self._tracing(self.lights), self._seed)
        logger.debug("auto: a camera path has the relative variance %.3g", noise)
        return noise

    def _has_specular(self) -> bool:
        bsdfs = [m for m in materials(self.scene) if isinstance(m, mi.BSDF)]
        specular = mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission
        return any(mi.has_flag(m.flags(), f) for m in bsdfs for f in specular)


def describe(counts: Candidate) -> str:
    """Counts in words."""
    for name, fixed in FIXED.items():
        if counts == fixed:
            return name
    name = "vcm" if counts.merging else "bpt"
    return f"{name} with {counts.light_paths:g} light paths, {counts.connections} connections"
