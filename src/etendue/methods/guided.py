r"""Path guiding: path tracing that learns the incident light while it renders.

The estimator is that of ``path``. Directions are sampled from a mixture of the BSDF and a
:class:`~etendue.transport.Guide`; the density of the mixture enters the MIS weights of light points. The guide
stores, for each cell of the scene and each leaf of a quadtree over the directions, the mean contribution of paths
[Muller 2017]:

.. math:: \int_{leaf} f_s(x, \omega) |cos| L(x, \omega) d\omega

where L contains the MIS weights of the picture, so that light found by light points at x counts little. Training has
generations; each has twice as many passes as the one before, and starts with refined trees and empty sums. The weight
of a pass in the picture depends only on its generation, so the mean is unbiased; weights by measured variances
[Muller 2019] would be biased. The guide also learns the share of its directions in each cell, so that it is used where
it pays, and the selection of lights, and Russian roulette uses its estimates [Vorba 2016].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

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
    copied_to_device,
    setting,
)
from etendue.film import Component
from etendue.scene import Problem
from etendue.transport import FITS, FOUND_UNITS, FirstHits, Guide, GuidedPath, GuidedWalk, TrainingSamples

from .base import STEP_LANES, ImageSettings, Layer, total
from .ending import EndsInMap
from .path import EndingPathSettings, Path, camera_paths
from .store import STORE_SHARE

#: Most camera paths of a pass that give training samples.
_PATHS = 1 << 18


@dataclass(frozen=True)
class GuidedSettings(EndingPathSettings):
    """Settings of ``guided``."""

    generations: int = setting(
        7,
        "generations of training, of 1, 2, 4, ... passes; the guide is fixed after the last one; 0: no guide",
        minimum=0,
        maximum=24,
    )
    share: float = setting(
        0.6,
        "largest probability of sampling a direction from the guide, else from the material; learned for each cell",
        above=0.0,
        maximum=0.99,
    )
    learn_lights: bool = setting(
        True, "learn for each cell the probabilities of the lights in next event estimation, with up to 16 lights"
    )
    cell_samples: int = setting(
        4000,
        "number of training samples above which a cell is divided, after a generation of one pass; times the root "
        "of the number of passes in later generations",
        minimum=100,
    )
    leaf_share: float = setting(
        0.02,
        "share of the light of a cell above which a leaf of its quadtree of directions is divided",
        minimum=0.001,
        maximum=1.0,
    )
    first_weight: float = setting(
        0.375,
        "weight of the first pass, which is not guided, in the picture; doubles with each generation, up to 1",
        above=0.0,
        maximum=1.0,
    )


class Guided(Carrying, EndsInMap):
    """Path tracing with directions sampled from a learned density for each cell of the scene."""

    name: ClassVar[str] = "guided"
    Settings: ClassVar[type[ImageSettings]] = GuidedSettings
    settings: GuidedSettings
    citations: ClassVar[tuple[str, ...]] = ("Muller2017", "Muller2019", "Vorba2016", "Shirley1997", *Path.citations)
    carries_on: ClassVar[bool] = True
    #: Five generations of training and a pass, if a budget has the samples.
    least_passes = 32

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`; the guide is untrained."""
        self._forget_states()
        super().prepare(problem, seed)
        box = problem.scene.bbox()
        lower, upper = (np.asarray(corner, np.float64).ravel().tolist() for corner in (box.min, box.max))
        learned = self.settings.learn_lights and self.settings.generations > 0
        self._guide = Guide(lower, upper, self.lights if learned else None)
        self._generation = 0
        self._passes = 0  # of this generation
        self._unit = 0.0  # mean luminance of a path; 0 before the first pass with light
        self._clear_sums()

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`."""
        return STEP_LANES

    def _clear_sums(self) -> None:
        self._found = dr.zeros(mi.UInt64, self._guide.places)
        self._seen = dr.zeros(mi.UInt32, self._guide.places)
        self._fits = dr.zeros(mi.UInt64, self._guide.cells * FITS)
        self._brought = dr.zeros(mi.UInt64, self._guide.cells * max(1, self._guide.light_count))

    @property
    def guide(self) -> Guide:
        """The guide as it is after the latest pass."""
        return self._guide

    # ------------------------------------------------------------------ a pass

    def _step(self, iteration: int, seed: int) -> Measurement:
        """One pass, with the weight of its generation."""
        weight = min(1.0, self.settings.first_weight * 2.0**self._generation)
        measurement = super()._step(iteration, seed)
        measurement.scale(weight)
        return measurement

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        training = self._generation < self.settings.generations
        collected = TrainingSamples(self._guide, lanes, self._stride(len(lanes)), self._unit, training)
        path = self._paths(lanes, samples, iteration, seed, collected)
        radiance, bad = self.kept_layers(path)
        found = dr.select(dr.isfinite(path.found), path.found, 0.0)
        dr.eval(radiance, path.rays, bad, found)
        if training:
            self._learn(collected, found)
        counters = {"rays": total(path.rays), "paths": float(len(lanes)), "nonfinite": total(bad)}
        return self.images(radiance, seed, iteration), counters

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        untrained = TrainingSamples(self._guide, lanes, 1, 0.0, False)
        dr.eval(self._paths(lanes, samples, iteration, seed, untrained).radiance)

    def _paths(
        self, lanes: mi.UInt32, samples: int, iteration: int, seed: int, collected: TrainingSamples
    ) -> GuidedPath:
        """The camera paths ``lanes`` of a pass with ``samples`` in a pixel, not yet evaluated."""

        def trace(ray: mi.Ray3f, source: SampleSource, first: FirstHits | None) -> GuidedPath:
            o = self.settings
            own = {"proposal": o.proposal, "guide": self._guide, "weights": o.direct_weights, "training": collected}
            walk = self.walker(GuidedWalk, **own, first=first)
            path = walk.trace(ray, source, **self.path_fields())
            if (light := self.light_of_map(path)) is not None:
                walk.add(path, light, mi.Bool(True), Component.INDIRECT)
            return path

        path = camera_paths(self, lanes, iteration, seed, samples, trace)
        assert isinstance(path, GuidedPath)
        return path

    def _stride(self, lanes: int) -> int:
        """Number of paths of which one gives training samples."""
        most = _PATHS
        if self.problem.memory:
            most = max(1, min(most, int(STORE_SHARE * self.problem.memory / TrainingSamples.path_bytes)))
        return -(-lanes // most)

    # ------------------------------------------------------------------ learning

    def _learn(self, collected: TrainingSamples, found: mi.Float) -> None:
        """Add the training samples of a pass to the sums, and update the guide at the end of a generation."""
        if self._unit <= 0.0:
            self._unit = float(np.asarray(found).mean(dtype=np.float64))
        if self._unit > 0.0:
            light, seen, fits = collected.deposit(self._guide, found, self._unit)
            self._found, self._seen, self._fits = self._found + light, self._seen + seen, self._fits + fits
        self._brought = self._brought + collected.brought
        dr.eval(self._found, self._seen, self._fits, self._brought)
        self._passes += 1
        if self._passes < 1 << self._generation:
            return
        o = self.settings
        self._guide.learn(
            np.array(self._found, np.float64) * (self._unit / FOUND_UNITS),
            np.array(self._seen),
            most=o.cell_samples * math.sqrt(self._passes),
            leaf_share=o.leaf_share,
            share=o.share,
            fits=np.array(self._fits, np.float64).reshape(self._guide.cells, -1),
            brought=np.array(self._brought, np.float64).reshape(self._guide.cells, -1),
        )
        self._generation += 1
        self._passes = 0
        self._clear_sums()

    def develop(self, measurement: Measurement, state: State) -> Result:
        """Weighted mean over the passes; the metadata contain the size of the guide."""
        result = super().develop(measurement, state)
        size = {"cells": len(state["guide"]["level"]), "places": len(state["found"])}
        result.metadata["guide"] = {"generation": state["generation"]} | size
        return result

    def _left(self) -> State:
        """The guide, and the sums of the current generation."""
        return {
            "generation": self._generation,
            "passes": self._passes,
            "unit": self._unit,
            "guide": self._guide.state(),
            "found": self._found,
            "seen": self._seen,
            "fits": self._fits,
            "brought": self._brought,
        } | dict(EndsInMap.start(self))

    def _take(self, state: State) -> None:
        EndsInMap.enter(self, state)
        if "fits" not in state:
            raise CheckpointError("the checkpoint is of another version of guided; start a new run")
        found, seen = np.asarray(state["found"], np.uint64), np.asarray(state["seen"], np.uint32)
        self._guide.restore(state["guide"])
        fits, brought = (np.asarray(state[name], np.uint64) for name in ("fits", "brought"))
        if (len(found), len(seen), len(fits)) != (self._guide.places, self._guide.places, self._guide.cells * FITS):
            raise CheckpointError("the guide in the checkpoint is damaged; start a new run")
        self._generation, self._passes, self._unit = (
            int(state["generation"]),
            int(state["passes"]),
            float(state["unit"]),
        )
        self._found, self._seen = copied_to_device(mi.UInt64, found), copied_to_device(mi.UInt32, seen)
        self._fits, self._brought = copied_to_device(mi.UInt64, fits), copied_to_device(mi.UInt64, brought)
