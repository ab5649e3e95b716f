r"""Path tracing that learns where light comes from.

The estimator is that of ``path``. Directions are drawn from the BSDF and a :class:`~etendue.transport.Guide` in turn,
and weighted against light points by the density of both together. The guide holds, for each cell of the scene and each
leaf of a quadtree over its directions, the mean of what paths found there [Muller 2017]:

.. math:: \int_{leaf} f_s(x, \omega) |cos| L(x, \omega) d\omega

with L as it counts in the picture, so what light points already see is not learned again. Training goes in generations,
each of twice as many passes as the one before; a generation begins with the trees refined by the last one and sums of
zero. Every pass counts in the picture with a weight that its generation alone decides, so the mean is unbiased
[Muller 2019 weights by measured variances instead, which is not]. What the cells found also decides which light points
are drawn on, and roulette [Vorba 2016].
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Carrying, CheckpointError, Measurement, Result, State, copied_to_device, setting
from etendue.scene import LightTable, Problem
from etendue.transport import (
    MOST_LIGHTS,
    NOWHERE,
    DirectSample,
    Evaluated,
    Guide,
    GuidedScattered,
    LightChoice,
    LocalLights,
    roulette,
)
from etendue.transport import dimensions as dim

from .base import STEP_LANES, ImageSettings, Layer, total
from .path import Path, PathSettings, PathState
from .store import STORE_SHARE

#: Camera paths of a pass that are learned from at most, and vertices of each, from the first on.
_PATHS = 1 << 18
_VERTICES = 6
#: Bytes of a vertex that is learned from.
_BYTES = 16
#: What a path found is added up in integers, whose sum does not depend on the order: so many to the picture's mean,
#: and a path counts as many times the mean at most.
_PARTS = 1 << 20
_MOST = 1 << 14
#: Throughput below which what a path finds is not divided by it.
_FAINT = 1e-20
#: Roulette lets a path go on at least with this probability.
_LEAST_SURVIVAL = 0.1


@dataclass(frozen=True)
class GuidedSettings(PathSettings):
    """Settings of ``guided``."""

    generations: int = setting(
        7, "generations of training, of 1, 2, 4, ... passes; then the guide stays; 0 is path", minimum=0, maximum=24
    )
    share: float = setting(0.6, "probability with which a direction is drawn from the guide", above=0.0, maximum=0.99)
    learn_lights: bool = setting(True, "learn for each cell which light to draw points on; with up to 16 lights")
    cell_samples: int = setting(
        4000,
        "vertices in a cell above which it is divided, after the first generation; grows with the root of the passes",
        minimum=100,
    )
    leaf_share: float = setting(
        0.02, "share of a cell's light above which a leaf of its directions is divided", minimum=0.001, maximum=1.0
    )
    first_weight: float = setting(
        0.125,
        "weight in the picture of the pass before anything is learned; doubles with each generation, to 1",
        above=0.0,
        maximum=1.0,
    )


class _Records:
    """What paths find out at their vertices: where they went on to, and what they had found and carried until then."""

    def __init__(self, lanes: Any, stride: int, recording: bool) -> None:
        opaque = dr.opaque(mi.UInt32, stride)
        self.count = -(-len(lanes) // stride) if recording else 0
        self._path = lanes // opaque
        self._mine = dr.opaque(mi.Bool, recording) & (self._path * opaque == lanes)
        self._stride = opaque
        self._packets = dr.zeros(mi.UInt32, 4 * max(1, self.count * _VERTICES))

    def put(self, s: PathState, scattered: Any) -> None:
        """Vertex ``s.depth``, which the path leaves."""
        active = self._mine & s.active & (scattered.place != NOWHERE) & (s.depth <= _VERTICES)
        carried = dr.rcp(dr.maximum(mi.luminance(s.throughput), _FAINT))
        bits = (dr.reinterpret_array(mi.UInt32, value) for value in (s.parts[0], carried))
        packet = mi.Vector4u(scattered.place + 1, *bits, 0)
        dr.scatter(self._packets, packet, self._path * _VERTICES + (s.depth - 1), active)

    def deposit(self, places: int, light: Any, unit: float) -> tuple[Any, Any]:
        """Place by place, what the paths, which found ``light`` in all, found beyond each vertex, in parts of ``unit``;
        and how many looked there."""
        found, seen = dr.zeros(mi.UInt64, places), dr.zeros(mi.UInt32, places)
        path = dr.arange(mi.UInt32, self.count)
        light = dr.gather(mi.Float, light, path * self._stride)
        scale = dr.opaque(mi.Float, _PARTS / unit)
        for vertex in range(_VERTICES):
            packet = dr.gather(mi.Vector4u, self._packets, path * _VERTICES + vertex)
            before, factor = (dr.reinterpret_array(mi.Float, packet[i]) for i in (1, 2))
            value = dr.minimum((light - before) * factor * scale, float(_PARTS * _MOST))
            active = packet[0] > 0
            place = packet[0] - 1
            # Directly: other ways have the number of places in the kernel.
            dr.scatter_add(seen, mi.UInt32(1), place, active, dr.ReduceMode.Direct)
            active &= value >= 1.0
            dr.scatter_add(found, mi.UInt64(value), place, active, dr.ReduceMode.Direct)
        return found, seen


class Guided(Carrying, Path):
    """Path tracing guided by a density over directions that it learns, cell by cell of the scene."""

    name: ClassVar[str] = "guided"
    Settings: ClassVar[type[ImageSettings]] = GuidedSettings
    citations: ClassVar[tuple[str, ...]] = ("Muller2017", "Muller2019", "Vorba2016", "Shirley1997", *Path.citations)
    carries_on: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """A guide that knows nothing."""
        self._forget_states()
        super().prepare(problem, seed)
        box = problem.scene.bbox()
        lower, upper = (np.asarray(corner, np.float64).ravel().tolist() for corner in (box.min, box.max))
        self._guide = Guide(lower, upper)
        #: None where there is no choice, or too much of it.
        few = 1 < self.lights.count <= MOST_LIGHTS and self.settings.learn_lights and self.settings.generations > 0
        self._choice = LightChoice(self.lights, self._guide.cells) if few else None
        self._generation = 0
        self._passes = 0  # of this generation
        self._unit = 0.0  # mean light of a path, once it is known
        self._forget()

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`."""
        return STEP_LANES

    def _forget(self) -> None:
        self._found = dr.zeros(mi.UInt64, self._guide.places)
        self._seen = dr.zeros(mi.UInt32, self._guide.places)
        self._brought = dr.zeros(mi.UInt64, self._guide.cells * self.lights.count)

    # ------------------------------------------------------------------ a pass

    def _step(self, iteration: int, seed: int) -> Measurement:
        """One pass, in the weight of its generation."""
        weight = min(1.0, self.settings.first_weight * 2.0**self._generation)
        measurement = super()._step(iteration, seed)
        measurement.scale(weight)
        return measurement

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        training = self._generation < self.settings.generations
        #: Of the light that is counted, to a unit of luminance; 0 while it is not counted.
        self._parts = dr.opaque(mi.Float, _PARTS / self._unit if training and self._unit > 0.0 else 0.0)
        self._records = _Records(lanes, self._stride(len(lanes)), training)
        #: What points of each light bring to each cell, in the same unit.
        self._lit = dr.zeros(mi.UInt64, self._guide.cells * self.lights.count)
        state = self.trace(lanes // samples, self.camera_numbers(lanes, samples, seed, iteration))
        radiance, bad = self.kept(state.radiance)
        light = dr.select(dr.isfinite(state.parts[0]), state.parts[0], 0.0)
        dr.eval(radiance, state.rays, bad, light)
        if training:
            self._learn(light)
        del self._records, self._parts, self._lit
        counters = {"rays": total(state.rays), "paths": float(len(lanes)), "nonfinite": total(bad)}
        return {"image": self.image(radiance, seed, iteration)}, counters

    def _stride(self, lanes: int) -> int:
        """One in so many paths is learned from."""
        most = _PATHS
        if self.problem.memory:
            most = max(1, min(most, int(STORE_SHARE * self.problem.memory / (_BYTES * _VERTICES))))
        return -(-lanes // most)

    def locate(self, s: PathState, si: Any) -> Any:
        """The cell."""
        return self._guide.locate(si, s.active)

    def lights_at(self, here: Any) -> LightTable | LocalLights:
        """With the probabilities of the cell."""
        return self.lights if self._choice is None else self._choice.at(here)

    def lights_of_edge(self, s: PathState) -> LightTable | LocalLights:
        """With those of the cell that the edge comes from."""
        return self.lights if self._choice is None else self._choice.at(s.parts[3])

    def scatter(
        self,
        here: Any,
        bsdf: Any,
        si: Any,
        source: Any,
        vertex: Any,
        active: Any,
        directions: Sequence[tuple[Any, Any]] = (),
    ) -> tuple[GuidedScattered, list[Evaluated]]:
        """By the BSDF and the guide in turn."""
        plain = functools.partial(super().scatter, here)
        return self._guide.scatter(here, plain, bsdf, si, source, vertex, active, directions)

    def lit(self, s: PathState, here: Any, direct: DirectSample, contribution: Any, active: Any) -> None:
        """Count what the light brought to the cell."""
        if self._choice is None:
            return
        parts = mi.luminance(contribution) / dr.maximum(mi.luminance(s.throughput), _FAINT) * self._parts
        parts = mi.UInt64(dr.minimum(dr.select(active & (parts >= 1.0), parts, 0.0), float(_PARTS * _MOST)))
        place = here * self.lights.count + direct.light
        dr.scatter_add(self._lit, parts, place, active & (self._parts > 0.0), dr.ReduceMode.Direct)

    def parts(self, source: Any) -> list[Any]:
        """The luminance that the path has found; what it is expected to find from here on, and was at first; the cell
        that the edge comes from."""
        return [mi.Float(0.0), mi.Float(0.0), mi.Float(0.0), mi.UInt32(0)]

    def add(self, s: PathState, source: Any, contribution: Any, active: Any, by_light_point: bool) -> None:
        """See :class:`Path`."""
        super().add(s, source, contribution, active, by_light_point)
        s.parts[0] = s.parts[0] + dr.select(active, mi.luminance(contribution), 0.0)

    def leave(self, s: PathState, here: Any, scattered: Any) -> None:
        """Remember the vertex."""
        self._records.put(s, scattered)
        known = s.active & (scattered.glow > 0.0)
        carried = mi.luminance(s.throughput) * scattered.glow
        s.parts[1] = dr.select(known, carried, s.parts[1] * dr.max(scattered.weight))
        s.parts[2] = dr.select(known & (s.parts[2] == 0.0), carried, s.parts[2])
        s.parts[3] = dr.select(scattered.is_null, s.parts[3], here)

    def survives(self, s: PathState, source: Any) -> Any:
        """By the light that the path is expected to bring from here, relative to that of its first vertex
        [Vorba 2016]. The throughput would end the best paths: it is small where the guide expects much light."""
        u = source.decide(s.depth, dim.ROULETTE)
        expects = s.parts[2] > 0.0
        worth = dr.select(expects, mi.Color3f(dr.maximum(s.parts[1] / s.parts[2], _LEAST_SURVIVAL)), s.throughput)
        alive, factor = roulette(worth, dr.select(expects, 1.0, s.eta), s.depth, self.settings.rr_depth, u)
        s.throughput *= factor
        s.parts[1] = s.parts[1] * factor
        return alive

    # ------------------------------------------------------------------ learning

    def _learn(self, light: Any) -> None:
        """Count what a pass found, and take it over at the end of a generation."""
        if self._unit <= 0.0:
            self._unit = float(np.asarray(light).mean(dtype=np.float64))
        if self._unit > 0.0:
            found, seen = self._records.deposit(self._guide.places, light, self._unit)
            self._found, self._seen = self._found + found, self._seen + seen
        self._brought = self._brought + self._lit
        dr.eval(self._found, self._seen, self._brought)
        self._passes += 1
        if self._passes < 1 << self._generation:
            return
        o = self.settings
        origin = self._guide.learn(
            np.array(self._found, np.float64) * (self._unit / _PARTS),
            np.array(self._seen),
            most=o.cell_samples * math.sqrt(self._passes),
            leaf_share=o.leaf_share,
            share=o.share,
        )
        if self._choice is not None:
            brought = np.array(self._brought, np.float64).reshape(-1, self.lights.count)
            self._choice.learn(brought, origin)
        self._generation += 1
        self._passes = 0
        self._forget()

    def develop(self, measurement: Measurement, state: State) -> Result:
        """Weighted mean over the passes; the metadata say how large the guide is."""
        result = super().develop(measurement, state)
        size = {"cells": self._guide.cells, "places": len(state["found"])}
        result.metadata["guide"] = {"generation": state["generation"]} | size
        return result

    def _left(self) -> State:
        """The guide, and what was found since it was changed last."""
        return {
            "generation": self._generation,
            "passes": self._passes,
            "unit": self._unit,
            "guide": self._guide.state(),
            "found": self._found,
            "seen": self._seen,
            "brought": self._brought,
            **({} if self._choice is None else {"lights": self._choice.shares}),
        }

    def _take(self, state: State) -> None:
        found, seen = np.asarray(state["found"], np.uint64), np.asarray(state["seen"], np.uint32)
        self._guide.restore(state["guide"])
        if (len(found), len(seen)) != (self._guide.places, self._guide.places):
            raise CheckpointError("the checkpoint's guide is damaged; start anew")
        self._generation, self._passes, self._unit = (
            int(state["generation"]),
            int(state["passes"]),
            float(state["unit"]),
        )
        brought = np.asarray(state["brought"], np.uint64)
        self._found, self._seen = copied_to_device(mi.UInt64, found), copied_to_device(mi.UInt32, seen)
        self._brought = copied_to_device(mi.UInt64, brought)
        if self._choice is not None:
            self._choice.restore(state["lights"])
