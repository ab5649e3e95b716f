r"""Path guiding: path tracing that learns the incident light while it renders.

The estimator is that of ``path``. Directions are sampled from a mixture of the BSDF and a
:class:`~etendue.transport.Guide`; the density of the mixture enters the MIS weights of light points. The guide
stores, for each cell of the scene and each leaf of a quadtree over the directions, the mean contribution of paths
[Muller 2017]:

.. math:: \int_{leaf} f_s(x, \omega) |cos| L(x, \omega) d\omega

where L contains the MIS weights of the picture, so that light found by light points at x counts little. Training has
generations; each has twice as many paths as the one before, and starts with refined trees and empty sums. The weight
of a path in the picture depends only on its generation, so the mean is unbiased; weights by measured variances
[Muller 2019] would be biased. The guide also learns the share of its directions in each cell, so that it is used where
it pays, and the selection of lights, and Russian roulette uses its estimates [Vorba 2016]. If it does not pay in the
picture as a whole (:mod:`.gain`), the following passes are those of ``path``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
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
    logger,
    setting,
)
from etendue.film import Component
from etendue.scene import Problem, corners_of
from etendue.transport import FITS, FOUND_UNITS, CameraPath, FirstHits, Guide, GuidedPath, GuidedWalk, TrainingSamples

from .base import STEP_LANES, ImageSettings, Layer, total
from .ending import EndsInMap
from .gain import Gain
from .openings import through_openings
from .path import Path, WindowPathSettings, camera_paths, trace_path
from .store import STORE_SHARE

#: Most camera paths of a lot that give training samples.
_PATHS = 1 << 20
#: Ratio of products of error and cost, with the guide and without, above which the guide is given up.
_LOSS = 1.05


@dataclass(frozen=True)
class GuidedSettings(WindowPathSettings):
    """Settings of ``guided``."""

    generations: int = setting(
        7,
        "generations of training, of 1, 2, 4, ... lots of camera paths; the guide is fixed after the last one; 0: no "
        "guide",
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
        "number of training samples above which a cell is divided, after a generation of one lot; times the root "
        "of the number of lots in later generations",
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
        "weight of the first lot, which is not guided, in the picture; doubles with each generation, up to 1",
        above=0.0,
        maximum=1.0,
    )
    give_up: bool = setting(
        True,
        "go on without the guide if, in the last generation of training, the error that it saves is estimated to be "
        "worth less than the time that it takes",
    )


class Guided(Carrying, EndsInMap):
    """Path tracing with directions sampled from a learned density for each cell of the scene."""

    name: ClassVar[str] = "guided"
    Settings: ClassVar[type[ImageSettings]] = GuidedSettings
    settings: GuidedSettings
    citations: ClassVar[tuple[str, ...]] = ("Muller2017", "Muller2019", "Vorba2016", "Shirley1997", *Path.citations)
    carries_on: ClassVar[bool] = True
    media: ClassVar[str | None] = "scattering"
    spectral: ClassVar[bool] = True
    one_way = True
    measures: ClassVar[bool] = True
    #: A lot is a pass at most: five generations of training and a pass, if a budget has the samples.
    least_passes = 32

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`; the guide is untrained."""
        self._forget_states()
        super().prepare(problem, seed)
        self.lights = through_openings(self, seed)
        lower, upper = (corner.tolist() for corner in corners_of(problem.scene))
        learned = self.settings.learn_lights and self.settings.generations > 0
        self._guide = Guide(lower, upper, self.lights if learned else None)
        self._generation = 0
        self._lots = 0  # of this generation
        self._given_up = False
        self._weight = 1.0  # of the latest pass
        self._unit = 0.0  # mean luminance of a path; 0 before the first lot with light
        self._gain = Gain(self.camera.pixels)
        self._clear_sums()

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`. As many as ``path`` has."""
        return 2 * super().full_lanes()

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
        """One pass, with the mean weight of its lots."""
        measurement = super()._step(iteration, seed)
        measurement.scale(self._weight)
        return measurement

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`. In training, the samples are made in parts, and the guide may learn after each."""
        pixels = self.camera.pixels
        lot = min(max(1, STEP_LANES // pixels), samples)
        layers: dict[str, mi.Color3f] = {}
        counters = {"rays": 0.0, "paths": float(pixels * samples), "nonfinite": 0.0}
        first, self._weight = 0, 0.0
        while first < samples:
            count, weight = samples - first, 1.0
            if self._trains:
                count = min(count, lot * ((1 << self._generation) - self._lots))
                weight = min(weight, self.settings.first_weight * 2.0**self._generation)
            number = dr.arange(mi.UInt32, pixels * count)
            pixel = number // dr.opaque(mi.UInt32, count)
            lanes = number + pixel * dr.opaque(mi.UInt32, samples - count) + dr.opaque(mi.UInt32, first)
            radiance, rays, bad = self._part(lanes, count, lot, samples, iteration, seed)
            counters["rays"] += rays
            counters["nonfinite"] += bad
            for name, light in radiance.items() if count < samples else ():
                layers.setdefault(name, dr.zeros(type(light), pixels * samples))
                dr.scatter(layers[name], light * dr.opaque(mi.Float, weight), lanes)
            first, self._weight = first + count, self._weight + weight * count / samples
        whole = dr.opaque(mi.Float, 1.0 / self._weight)
        layers = {name: light * whole for name, light in layers.items()} or radiance
        return self.images(layers, seed, iteration), counters

    def _part(
        self, lanes: mi.UInt32, count: int, lot: int, samples: int, iteration: int, seed: int
    ) -> tuple[dict[str, mi.Spectrum], float, float]:
        """The camera paths ``lanes`` of a pass, ``count`` of each pixel, from which the guide learns: (light by layer,
        rays, values that were not finite). ``lot``: paths of each pixel of a lot."""
        own = dr.arange(mi.UInt32, len(lanes))
        collected = TrainingSamples(self._guide, own, self._stride(len(lanes)), self._unit, self._trains)
        path = self._paths(lanes, samples, iteration, seed, collected)
        radiance, bad = self.kept_layers(path)
        learned = []
        if isinstance(path, GuidedPath):
            learned = [dr.select(dr.isfinite(value), value, 0.0) for value in (path.found, path.plain_square)]
        dr.eval(radiance, path.rays, bad, learned)  # in one kernel
        rays = total(path.rays)
        if self._trains:
            found, square = learned
            self._gain.add(found, square, count, rays / len(lanes))
            self._lots += -(-count // lot)
            self._learn(collected, found)
        return radiance, rays, total(bad)

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        untrained = TrainingSamples(self._guide, lanes, 1, 0.0, False)
        dr.eval(self._paths(lanes, samples, iteration, seed, untrained).radiance)

    def _paths(
        self, lanes: mi.UInt32, samples: int, iteration: int, seed: int, collected: TrainingSamples
    ) -> CameraPath:
        """The camera paths ``lanes`` of a pass with ``samples`` in a pixel, not yet evaluated."""
        if self._given_up:
            return camera_paths(self, lanes, iteration, seed, samples, partial(trace_path, self))

        def trace(ray: mi.Ray3f, source: SampleSource, first: FirstHits | None) -> GuidedPath:
            o = self.settings
            own = {"proposal": o.proposal, "guide": self._guide, "weights": o.direct_weights, "training": collected}
            walk = self.walker(GuidedWalk, **own, first=first)
            path = walk.trace(ray, source, **self.path_fields())
            if (light := self.light_of_map(path)) is not None:
                walk.add(path, light, mi.Bool(True), Component.INDIRECT)
            return path

        return camera_paths(self, lanes, iteration, seed, samples, trace)

    def _stride(self, lanes: int) -> int:
        """Number of paths of which one gives training samples."""
        most = _PATHS
        if self.problem.memory:
            most = max(1, min(most, int(STORE_SHARE * self.problem.memory / TrainingSamples.path_bytes)))
        return -(-lanes // most)

    # ------------------------------------------------------------------ learning

    @property
    def _trains(self) -> bool:
        """Whether the guide learns from the next paths."""
        return not self._given_up and self._generation < self.settings.generations

    def _learn(self, collected: TrainingSamples, found: mi.Float) -> None:
        """Add training samples to the sums, and update the guide at the end of a generation."""
        if self._unit <= 0.0:
            self._unit = float(np.asarray(found).mean(dtype=np.float64))
        if self._unit > 0.0:
            light, seen, fits = collected.deposit(self._guide, found, self._unit)
            self._found, self._seen, self._fits = self._found + light, self._seen + seen, self._fits + fits
        self._brought = self._brought + collected.brought
        dr.eval(self._found, self._seen, self._fits, self._brought)
        if self._lots < 1 << self._generation:
            return
        o = self.settings
        self._guide.learn(
            np.array(self._found, np.float64) * (self._unit / FOUND_UNITS),
            np.array(self._seen),
            most=o.cell_samples * math.sqrt(self._lots),
            leaf_share=o.leaf_share,
            share=o.share,
            fits=np.array(self._fits, np.float64).reshape(self._guide.cells, -1),
            brought=np.array(self._brought, np.float64).reshape(self._guide.cells, -1),
        )
        self._generation += 1
        self._lots = 0
        ratio = self._gain.end_generation()
        logger.debug("guided: generation %d has %.3g times the error times cost of path", self._generation, ratio)
        self._given_up = o.give_up and self._generation == o.generations and ratio > _LOSS
        if self._given_up:
            logger.info("guided: the guide does not pay; paths are those of path from now on")
        self._clear_sums()

    def develop(self, measurement: Measurement, state: State) -> Result:
        """Weighted mean over the passes; the metadata contain the size of the guide."""
        result = super().develop(measurement, state)
        size = {"cells": len(state["guide"]["level"]), "places": len(state["found"])}
        result.metadata["guide"] = {"generation": state["generation"], "given_up": state["given_up"]} | size
        return result

    def _left(self) -> State:
        """The guide, and the sums of the current generation."""
        return {
            "generation": self._generation,
            "lots": self._lots,
            "given_up": self._given_up,
            "gain": self._gain.state(),
            "unit": self._unit,
            "guide": self._guide.state(),
            "found": self._found,
            "seen": self._seen,
            "fits": self._fits,
            "brought": self._brought,
        } | dict(EndsInMap.start(self))

    def _take(self, state: State) -> None:
        EndsInMap.enter(self, state)
        if "gain" not in state:
            raise CheckpointError("the checkpoint is of another version of guided; start a new run")
        found, seen = np.asarray(state["found"], np.uint64), np.asarray(state["seen"], np.uint32)
        self._guide.restore(state["guide"])
        fits, brought = (np.asarray(state[name], np.uint64) for name in ("fits", "brought"))
        if (len(found), len(seen), len(fits)) != (self._guide.places, self._guide.places, self._guide.cells * FITS):
            raise CheckpointError("the guide in the checkpoint is damaged; start a new run")
        self._generation, self._lots = int(state["generation"]), int(state["lots"])
        self._given_up, self._unit = bool(state["given_up"]), float(state["unit"])
        self._gain.restore(state["gain"])
        self._found, self._seen = copied_to_device(mi.UInt64, found), copied_to_device(mi.UInt32, seen)
        self._fits, self._brought = copied_to_device(mi.UInt64, fits), copied_to_device(mi.UInt64, brought)
