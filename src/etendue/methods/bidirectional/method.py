r"""Bidirectional path tracing, bidirectional photon mapping, and their combination, vertex connection and merging.

One estimator whose techniques can be switched on and off. A pass traces N light sub-paths and stores their vertices,
then traces one camera sub-path per sample; at each camera vertex it adds the contributions of all techniques, with
their MIS weights [Georgiev 2012, eq. 9]:

.. math::
    I = \sum_{s,t} \frac{1}{n_{VC}} w^{VC}_{s,t} \frac{f}{p^{VC}_{s,t}}
      + \sum_{s \ge 2, t \ge 2} \frac{1}{n_{VM}} w^{VM}_{s,t} \frac{f^{VM}}{p^{VM}_{s,t}}

- ``bpt``: emission hits, next event, connections, camera splats. Unbiased.
- ``bpm``: merging, and hits on lights seen directly or through mirrors and glass. Consistent.
- ``vcm``: all of them. Consistent: after m camera paths per pixel the merge radius is
  :math:`r_1 (m + 1)^{(\alpha - 1)/2}`.

Limit: a caustic of a point light that is seen in a mirror is found by merging only, blurred by the radius.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Carrying, IndependentSource, State, logger
from etendue.density import HashGrid
from etendue.film import REFLECTED
from etendue.scene import LightTable, Problem, corners_of
from etendue.transport import (
    CLASSES,
    PICK_BLOCK,
    CameraSink,
    CameraWalk,
    Candidate,
    Gather,
    Kind,
    Learned,
    LearnedConnections,
    LearnedEmission,
    LightCache,
    LightVertices,
    LightWalk,
    Mis,
    Moments,
    Pyramid,
    Splats,
    SplatSink,
    Techniques,
    learned_emission,
    needs_interaction,
)

from .. import base, radius as radii
from ..base import PILOT_PATHS, ImageMethod, ImageSettings, Lanes, Layer, total, with_image
from ..numbers import path_numbers
from ..openings import look_around, through_openings
from ..store import Group, VertexRoom, check_pyramid, concatenated
from .settings import BidirectionalSettings


class Bidirectional(Carrying, ImageMethod):
    """The estimator of ``bpt``, ``bpm`` and ``vcm``, which differ in their default settings."""

    Settings: ClassVar[type[ImageSettings]] = BidirectionalSettings
    settings: BidirectionalSettings
    citations: ClassVar[tuple[str, ...]] = (
        "Georgiev2012",
        "Georgiev2012b",
        "Hachisuka2012",
        "Davidovic2014",
        "Rath2023",
        "Krivanek2014",
    )
    media: ClassVar[str | None] = "scattering"
    spectral: ClassVar[bool] = True
    #: Estimates of the second moments of the next passes, if wanted; cleared at the beginning of a pass. If it is set
    #: before :meth:`prepare`, the pilot uses the same kernels as these passes.
    moments: Moments | None = None
    #: Points of the light paths' sequence that a pass takes, if more than its light paths.
    light_stride = 0
    #: Factor on the merge radius of the next pass.
    widening = 1.0
    #: The lights with their openings, if they are known before :meth:`prepare`.
    opened: LightTable | None = None
    _learning: LearnedEmission | None = None
    _choosing: LearnedConnections | None = None
    #: The light vertices of the pilot, on surfaces as they are searched, and all.
    _searched: Gather | None = None
    _searched_in: LightVertices | None = None

    @property
    def _learned(self) -> dict[str, Learned]:
        """The learned densities, by name in the state."""
        learned = {"emission": self._learning, "connections": self._choosing}
        return {name: one for name, one in learned.items() if one}

    @property
    def carries_on(self) -> bool:  # type: ignore[override]
        """Whether passes learn from earlier ones; known after :meth:`prepare`."""
        return bool(self._learned)

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. A pilot pass measures the number of light vertices and the mean radiance."""
        self._forget_states()
        super().prepare(problem, seed)
        self.lights = (
            through_openings(self, seed) if self.opened is None else self.opened.at_wavelengths_of(self.packet)
        )
        self._learning = learned_emission(self.settings.guide_emission, self.lights, problem.size)
        s = self.settings
        self.techniques = Techniques(
            emission=int(s.connecting),
            next_event=s.next_events if s.connecting else 0,
            connection=(1 if s.light_source == "path" else s.connections) if s.connecting else 0,
            splat=s.connecting and self.camera.can_splat,
            merge=s.merging,
            merge_first=s.merge_first,
            direct=s.all_direct(self.lights.count),
            diffuse=s.diffuse_photons if s.connecting and s.connections else 1.0,
            beta=2 if s.heuristic == "power" else 1,
        )
        if s.connecting and not self.camera.can_splat:
            logger.info(
                "light paths cannot be connected to this sensor: caustics that only splats find are missing, or found "
                "by merging"
            )
        self._factors = (1.0, *radii.factors(s.radii))
        self.one_place = s.pyramid  # the pictures of a pyramid are filtered once, at the end of a pass
        if s.pyramid:
            check_pyramid(self.techniques, s.pyramid_depth, self.camera, problem.memory)
        self._indexed = needs_interaction(problem.scene)
        self._box = corners_of(problem.scene)
        if s.guide_connections and self.techniques.connection and s.light_source == "cache":
            box = self._box
            if self.lights.lines is not None:  # a room: the ground outside would leave one cell for it
                around = look_around(self, seed)
                box = around.lower, around.upper
            self._choosing = LearnedConnections(*box, problem.size)
        self._paths = max(1, round(s.light_paths * self.camera.pixels * self.samples_per_iteration))
        self._discs = radii.first_radius(self, s.radius, s.radius_unit) if s.merging else radii.FirstRadius(0.0)
        self._balls = radii.Balls()
        if self.visibility.volumes and s.merging:
            self._balls = radii.first_balls(self, self._discs, s.volume_radius, s.radius_unit, None)
        kinds = bool(self.techniques.connection), self.techniques.merge
        linear = bool(self._more_radii) or self.light_stride > 0
        bytes_per_vertex = LightVertices.bytes_per_vertex(*kinds, linear, bool(self._learning), bool(self._choosing))
        self._room = VertexRoom(bytes_per_vertex, LightVertices.floats_per_vertex(kinds[0]), problem.memory)
        self._pilot(seed)
        self._groups = self._count_groups()

    def use(self, counts: Candidate) -> None:
        """Set the sample counts of the next passes, instead of those of the settings."""
        merging = counts.merging and self.settings.merging
        self.techniques = replace(self.techniques, connection=counts.connections, merge=merging)
        self._paths = max(1, round(counts.light_paths * self.camera.pixels * self.samples_per_iteration))
        self._groups = self._count_groups()

    @property
    def sampled_lights(self) -> LightTable:
        """The lights with the probabilities of the next pass."""
        return self._learning.guide.lights if self._learning else self.lights

    @property
    def generation(self) -> int:
        """How often the densities of emission and connections have changed."""
        return sum(learned.generation for learned in self._learned.values())

    def left(self) -> State:
        """The state after a call of :meth:`render_pass` that was not part of a ``step``."""
        self._held = self._left()
        return self._held

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`. Half as many with merging, whose radius shrinks from pass to pass."""
        return super().full_lanes() // (2 if self.settings.merging or self.settings.pyramid else 1)

    # ------------------------------------------------------------------ pilots

    def _pilot(self, seed: int) -> None:
        """Measure the vertices of a light path and the mean radiance of the picture, by a small pass with its own seed
        roles."""
        self._dark = 0.0
        paths = min(PILOT_PATHS, self._paths)
        samples = min(PILOT_PATHS, self.camera.pixels)
        splats = self._splats(seed, 0, "pilot ")
        lanes = dr.arange(mi.UInt32, samples)
        pixel = dr.minimum(mi.UInt32((mi.Float(lanes) + 0.5) * (self.camera.pixels / samples)), self.camera.pixels - 1)
        films = splats, None, 64 * paths, self.moments
        run = Group("pilot ", 0, seed, self._discs.largest, Lanes(0, paths), lanes, pixel, 1, *films)
        radiance, counters = self._trace(run)
        if self._searched and self.settings.connecting:
            self._discs = radii.bounded(self, self._discs, self._searched, paths / self._paths)
        if self._searched_in and self.visibility.volumes:
            pilot = radii.Pilot(self._searched_in, paths, self.settings.light_paths)
            self._balls = radii.first_balls(
                self, self._discs, self.settings.volume_radius, self.settings.radius_unit, pilot
            )
        self._searched = self._searched_in = None
        self._room.per_path = counters["light_vertices"] / paths
        own = [value for name, value in radiance.items() if name not in self._more_radii]
        mean = float(sum(np.mean([np.asarray(channel, np.float64) for channel in value]) for value in own))
        if splats:
            images = splats.sums()
            splatted = images[: len(images) - len(self._more_radii)]
            mean += float(splatted.mean(dtype=np.float64)) * len(splatted) / paths
        # Rounded to steps, so that the order of atomic additions in the pilot does not change the picture.
        brightness = 2.0 ** (round(4.0 * math.log2(mean)) / 4.0) if mean > 0.0 else 0.0
        self._dark = self.settings.shadow_roulette * brightness
        for learned in self._learned.values():
            learned.measure(brightness)

    @property
    def _more_radii(self) -> tuple[str, ...]:
        """Layers of the additional radii."""
        return tuple(radii.layer(factor) for factor in self._factors[1:])

    def _splats(self, seed: int, iteration: int, role: str = "") -> Splats | None:
        if not self.techniques.splat:
            return None
        # The pictures of a pyramid add up to that of the pass, so both are made in the same way: without cells.
        images = (len(REFLECTED) if self.settings.components else 1) + len(self._more_radii)
        return self.splats(seed, iteration, images, role, in_cells=not self.settings.pyramid)

    def _count_groups(self) -> int:
        """Number of groups into which the light paths of a pass are divided, so that the vertices of a group fit into
        memory and its paths into a kernel."""
        groups = self._room.groups(self._paths)
        if groups > 1:
            needed = self._room.bytes(self._paths) / 1e6
            logger.info("light vertices of a pass need %.0f MB; light paths are traced in %d groups", needed, groups)
        return max(groups, -(-self._paths // base.MOST_LIGHT_LANES))

    def _left(self) -> State:
        """Number of groups, and vertices per light path, which change if a pass lacks capacity; learned densities."""
        learned = {name: one.state() for name, one in self._learned.items()}
        return {"groups": self._groups, "vertices_per_path": self._room.per_path} | learned

    def _take(self, state: State) -> None:
        self._groups, self._room.per_path = int(state["groups"]), float(state["vertices_per_path"])
        for name, learned in self._learned.items():
            learned.restore(state[name])

    # ------------------------------------------------------------------ a pass

    def radius(self, iteration: int) -> float:
        """Largest merge radius of a pass, from 0, render space [Georgiev 2012, eq. 10], before learned emission shrinks
        it."""
        return radii.reduced(self._discs.largest, iteration, self.settings.alpha, self.samples_per_iteration)

    def _radius_of(self, iteration: int) -> float:
        """Largest merge radius of a pass, 0 without merging."""
        radius = self.widening * self.radius(iteration) if self.techniques.merge else 0.0
        # As many light vertices in a disc as without learning: more take time, and a smaller disc blurs less.
        return radius / math.sqrt(self._learning.guide.crowding) if self._learning else radius

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        radius = self._radius_of(iteration)
        splats = self._splats(seed, iteration)
        s = self.settings
        pyramid = Pyramid(self.techniques, s.pyramid_depth, self.camera.pixels, self.packet) if s.pyramid else None
        if self.moments:
            self.moments.clear()
        parts: list[dict[str, mi.Spectrum]] = []
        counters = {"rays": 0.0, "light_vertices": 0.0, "nonfinite": 0.0}
        for index in range(self._groups):
            light = Lanes(0, self._paths).part(index, self._groups)
            camera, _ = Lanes(0, self.camera.pixels * samples).part(index, self._groups).numbers()
            # Another variable than the camera paths, as in the pilot, also if there is one path per pixel.
            pixel, capacity = camera // dr.opaque(mi.UInt32, samples), self._room.capacity(light.count)
            films = splats, pyramid, capacity, self.moments
            run = Group("", iteration, seed, radius, light, camera, pixel, samples, *films)
            radiance, counts = self._trace(run)
            if not self._room.held(counts["light_vertices"], light.count):
                self._groups = self._count_groups()  # the capacity was too small: repeat the whole pass
                return self.render_pass(iteration, seed, samples)
            parts.append(radiance)
            counters = {name: value + counts[name] for name, value in counters.items()}

        radiance = {name: concatenated([part[name] for part in parts]) for name in parts[0]}
        layers = self.images(radiance, seed, iteration)
        counters["paths"] = float(self.camera.pixels * samples + self._paths)
        if splats:
            # Splats are sums over N light paths; the weight of the layers is the number of samples.
            splatted = splats.sums(samples / self._paths)
            own = REFLECTED if s.components else ("splat" if s.split_layers else "image",)
            names = (*own, *self._more_radii)
            for name, image in zip(names, splatted, strict=True):
                layers[name] = np.add(layers[name], image, out=image) if name in layers else image
        more = {name: layers.pop(name) for name in self._more_radii}
        for learned in self._learned.values():
            if learned is not self._choosing or self.techniques.connection:
                learned.end_pass(with_image(layers)["image"], samples)
        if pyramid:
            more |= pyramid.layers(lambda values: self.image(values, seed, iteration))
        return with_image(layers) | more, counters

    def _mis(self, radius: float, paths: int, moments: Moments | None) -> Mis:
        """MIS weights of a pass that merges with ``paths`` light paths."""
        area = np.pi * radius * radius * paths * self.settings.eta_discount
        etas = [dr.opaque(mi.Float, area * factor**2) for factor in self._factors]
        candidates = []
        if moments:
            unit = dr.opaque(mi.Float, area / moments.used.light_paths)
            candidates = [candidate.counts(unit, self.camera.pixels) for candidate in moments.candidates]
        return Mis(self.techniques, etas, dr.opaque(mi.Float, self._paths / self.samples_per_iteration), candidates)

    def _trace(self, run: Group) -> tuple[dict[str, mi.Spectrum], dict[str, float]]:
        """Trace light paths, then camera paths. Kernels are queued without waiting, so that one runs while Python
        traces the next. Returns (radiance by technique family, one lane a camera path; counters)."""
        paths = run.light.count
        dr.make_opaque(run.camera, run.pixel)  # so that pilot and passes share kernels
        common = self._fields(run)
        mis, connecting = common["mis"], self.techniques.connection > 0
        choosing = self._choosing if connecting else None
        numbered = run.pyramid is not None and self.visibility.transparent
        vertices, sink = None, None
        if connecting or self.techniques.merge:
            owned = common.get("training") is not None or self.recording.light is not None
            vertices = LightVertices(
                run.capacity,
                paths,
                self._indexed,
                connecting,
                numbered,
                mis.linear,
                owned,
                self.visibility.volumes,
                self.visibility.disperses,
            )
        if run.splats:
            sink = SplatSink(
                pyramid=run.pyramid,
                splats=run.splats,
                paths_per_sample=mis.paths_per_sample,
                components=self.settings.components,
            )
        source = self.light_numbers(run.light, self._stride, run.seed, run.iteration, run.role + "light")
        light_rays, light_bad = self.walker(LightWalk, **common, sink=sink).trace(paths, source, vertices)
        dr.schedule(light_rays, light_bad)
        for film in (run.splats, run.pyramid, run.moments):
            if film:
                dr.schedule(film.array)
        if vertices:
            vertices.launch()
        dr.eval()

        picks = IndependentSource(run.camera // PICK_BLOCK, run.seed, run.role + "connect", run.iteration)
        cache, gather = self._cache(vertices, paths, picks), self._gather(vertices, paths, run.radius)
        in_media = self._gather(vertices, paths, run.radius, in_media=True) if self.visibility.volumes else None
        self._searched = gather if run.role else None
        self._searched_in = vertices if run.role and self.techniques.merge else None
        s = self.settings
        layers = CameraSink(
            pyramid=run.pyramid, split_layers=s.split_layers, components=s.components, more_radii=self._more_radii
        )
        first = self.first_hits(run.camera, run.iteration)
        common |= {"sink": layers, "cache": cache, "gather": gather, "gather_in_media": in_media, "first": first}
        trained = choosing.training(self._trains(run), run.light.first) if choosing else None
        walk = self.walker(CameraWalk, **common, choosing=trained)
        source = self.camera_numbers(run.camera, run.samples, run.seed, run.iteration, run.role + "camera")
        radiance, rays = walk.trace(run.pixel, source, run.camera)
        parts, bad = {name: value for name, value in radiance.items() if name not in self._more_radii}, {}
        together, bad["parts"] = self.kept_together(parts)
        radiance |= together
        for name in self._more_radii:
            radiance[name], bad[name] = self.kept(radiance[name])
        if run.pyramid:
            dr.schedule(run.pyramid.array)
        if run.moments:
            run.moments.schedule()
        dr.eval(radiance, rays, bad)  # one kernel
        if self._learning:
            self._learning.add(common["training"])
        if choosing and trained and cache:
            choosing.add(trained, cache.population())
        return radiance, {
            "rays": total(rays) + total(light_rays),
            "light_vertices": float(vertices.wanted[0]) if vertices else 0.0,
            "nonfinite": total(light_bad) + sum(total(flags) for flags in bad.values()),
        }

    def _fields(self, run: Group) -> dict[str, Any]:
        """Fields of both walks."""
        mis, dark = self._mis(run.radius, run.light.count, run.moments), dr.opaque(mi.Float, self._dark)
        common: dict[str, Any] = {"camera": self.camera, "mis": mis, "dark": dark, "moments": run.moments}
        common["by_albedo"] = self.settings.roulette == "albedo"
        choosing = self._choosing if self.techniques.connection else None
        common |= {"places": self._discs.places, "choice": choosing.guide if choosing else None}
        common["balls"] = dr.opaque(mi.Float, self._balls.thickness)
        return common | (self._learning.fields(self._trains(run), run.light.first) if self._learning else {})

    def _trains(self, run: Group) -> bool:
        """Whether learned densities are trained: not by the pilot, nor by rays that are recorded."""
        return not run.role and self.recording.light is None

    @property
    def _stride(self) -> int:
        """Points of the light paths' sequence that a pass takes."""
        return self._paths if self.settings.sampler == "hammersley" else max(self._paths, self.light_stride)

    # ------------------------------------------------------------------ rays

    def _group(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> Group:
        light, pixel = Lanes(0, self._paths).part(0, self._groups), lanes // dr.opaque(mi.UInt32, samples)
        films = self._splats(seed, iteration), None, self._room.capacity(light.count)
        return Group("", iteration, seed, self._radius_of(iteration), light, lanes, pixel, samples, *films)

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        self._trace(self._group(lanes, samples, iteration, seed))

    def trace_from_lights(self, number: mi.UInt32, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        o, fields = self.settings, self._fields(self._group(number, 1, iteration, seed))
        source = path_numbers(o.sampler, number, self._stride, seed, iteration, "light", o.scrambling)
        dr.eval(self.walker(LightWalk, **fields).trace(dr.width(number), source))

    def _cache(self, vertices: LightVertices | None, paths: int, picks: IndependentSource) -> LightCache | None:
        """The stored vertices, numbered for connections."""
        if not vertices or not self.techniques.connection:
            return None
        pairs = self.settings.light_source == "path"
        vertices.number(by_path=pairs)
        choice = (self._choosing.guide, vertices.sort(CLASSES)) if self._choosing else ()
        count = mi.UInt32(vertices.count)
        factor = dr.full(mi.Float, 1.0) if pairs else mi.Float(count) / (paths * self.techniques.connection)
        dr.eval(count, factor)
        return LightCache(vertices, count, factor, dr.opaque(mi.UInt32, paths), None if pairs else picks, *choice)

    def _gather(self, vertices: LightVertices | None, paths: int, disc: float, in_media: bool = False) -> Gather | None:
        """The stored vertices on surfaces or ``in_media``, sorted for merging; ``disc``: the largest radius on
        surfaces."""
        if not vertices or not self.techniques.merge:
            return None
        positions, kind, held = vertices.positions(in_media)
        if self.techniques.leaves_direct:
            held &= kind != mi.UInt32(Kind.DIRECT)
        if self.techniques.thins:
            held &= kind != mi.UInt32(Kind.UNMERGED)
        discs = [disc * factor for factor in self._factors]
        reach = [self._balls.radius(radius) for radius in discs] if in_media else discs
        depth = self._balls.thickness if in_media else 1.0
        grid = HashGrid(positions, max(reach), *self._box, held)
        factors = [dr.opaque(mi.Float, 1.0 / (np.pi * radius**2 * depth * paths)) for radius in discs]
        limits = [dr.opaque(mi.Float, radius**2) for radius in reach]
        photons = vertices.sorted_by(grid.destination, held, self.visibility.media if in_media else None)
        return Gather(grid, photons, factors, limits, in_media)
