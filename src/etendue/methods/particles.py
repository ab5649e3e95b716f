r"""Particle tracing: hits of light paths on surfaces, as records.

.. math:: \Phi(A) = \frac{1}{N} \sum_j \Phi_j

is the incident flux of a surface A, over the particles j on A, of N light paths [Jensen 1996].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import (
    Iterations,
    Measurement,
    Method,
    OptionError,
    Pass,
    Record,
    Result,
    SampleSource,
    SceneError,
    Settings,
    State,
    UnsupportedError,
    setting,
)
from etendue.particles import Keep, Particles, ParticleStore, ParticleWalk, Rows, Surfaces, SurfaceTable, columns_of
from etendue.scene import LightTable, Problem, graph, refuse_media, refuse_one_way, require_rgb
from etendue.transport import (
    EMISSION,
    FIRST_BOUNCE,
    BlindEmission,
    CameraSampler,
    EmissionScheme,
    ImportancePilot,
    StratifiedSource,
    UniformLights,
    Visibility,
    emit,
    scatter_light,
    scatter_light_uniform,
)

from .base import MOST_LIGHT_LANES, PILOT_PATHS, total
from .numbers import path_numbers

#: Particles of a pass, if the number of paths is not given; they take 64 bytes on the device, and 64 more when sorted.
_PASS_PARTICLES = 1 << 20
#: Most paths of a pass, if their number is not given; and memory of a particle, in bytes.
_PASS_PATHS = 1 << 22
_BYTES = 192
#: Share of a memory limit that the particles of a pass may take.
_MEMORY_SHARE = 0.4
#: Capacity beyond the expected number of particles: a factor, and a number of particles.
_MARGIN, _PAD = 1.05, 1024
#: Pilots grow until one finds the first number of particles; the second is the most pilots.
_ENOUGH, _PILOTS = 1024, 3
#: Most particles of a store, which has 16 numbers for each, and fewer than 2^32 in all.
_MOST_STORED = 1 << 28
#: Names in a measurement.
RECORD, PATHS = "particles", "paths"


@dataclass(frozen=True)
class ParticleSettings(Settings):
    """Settings that determine the particles."""

    keep: str = setting(
        "all",
        "hits that become particles: all; the first of a path on a surface with a diffuse or glossy part (first); or "
        "that in which a path ends, with the flux that is absorbed instead of that which arrives (absorbed)",
        choices=tuple(kept.value for kept in Keep),
    )
    after: int = setting(0, "leave out hits with this number of edges from the light or fewer", minimum=0)
    specular: bool = setting(False, "also keep hits on surfaces without a diffuse or glossy part")
    max_bounces: int = setting(-1, "edges of the longest light path; -1: no limit", minimum=-1)
    rr_depth: int = setting(5, "path length, in edges, from which on Russian roulette may end a path", minimum=1)
    bsdf_sampling: bool = setting(
        True, "sample directions from the material; false: uniformly over sphere or hemisphere, for experiments"
    )
    sampler: str = setting(
        "owen",
        "random numbers of the paths: Owen-scrambled Sobol' points (owen), independent numbers (independent), or these "
        "with one path in each stratum of light, point, direction and first bounce (strata)",
        choices=("owen", "independent", "strata"),
    )
    emission: str = setting(
        "power",
        "how lights are sampled: by power (power), all equally often (uniform), these with rays spread evenly over the "
        "hemisphere (blind), or by what reaches the surfaces that the camera sees, as a pilot finds (importance)",
        choices=("power", "uniform", "blind", "importance"),
    )
    pilot: int = setting(1 << 16, "with importance: light paths of the pilot", minimum=64, maximum=1 << 24)
    defence: float = setting(
        0.25, "with importance: share of the rays that are sampled by power", above=0.0, maximum=1.0
    )
    samples_per_pass: int = setting(
        0, "light paths of a pass; 0: chosen so that a pass has about a million particles", minimum=0
    )


class ParticleTracing(Method):
    """Independent light paths, whose hits on surfaces are particles.

    A measurement has the record ``particles`` (:data:`etendue.particles.Rows`, in the scene's units, ordered by path;
    the power is not divided by the number of paths) and the counters ``paths``, ``particles`` and ``rays``. A sample of
    a budget is a light path. Each pass traces :attr:`samples_per_iteration` paths.
    """

    name: ClassVar[str] = "particles"
    counts: ClassVar[str] = "paths"
    Settings: ClassVar[type[Settings]] = ParticleSettings
    citations: ClassVar[tuple[str, ...]] = ("Jensen1996", "Leeson2001")

    def __init__(self, settings: ParticleSettings | None = None) -> None:
        self.settings = settings if settings is not None else ParticleSettings()
        #: Particles of a light path, measured by a pilot; it determines the paths of a pass.
        self.per_path = 0.0
        #: Particles of a light path for which there is room: the largest mean of a pass so far.
        self._room = 0.0

    def prepare(self, problem: Problem, seed: int) -> None:
        """Build the tables, and trace pilots. Raises :class:`SceneError` if they find no particle."""
        self._build(problem, seed)
        paths, found = PILOT_PATHS, 0
        for attempt in range(_PILOTS):
            found = self._trace("pilot ", attempt, seed, paths, 64 * PILOT_PATHS)[0].count
            if found >= _ENOUGH:
                break
            paths *= 8 if attempt + 1 < _PILOTS else 1
        if not found:
            raise SceneError(
                f"none of {paths} light paths of '{problem.source}' left a particle: no light arrives at the "
                "surfaces that are asked for; look at the lights, and at keep, after, specular and max_bounces"
            )
        self.per_path = self._room = found / paths

    def _build(self, problem: Problem, seed: int) -> None:
        settings = self.settings
        self.problem = problem
        require_rgb("particles")
        refuse_media(problem.scene, "particles", problem.sensor)
        refuse_one_way(problem.scene, "the tracing of particles")
        graph.without_literals(problem.scene)
        self.lights = LightTable(problem.scene)
        self._table = SurfaceTable(problem)
        keep = Keep(settings.keep)
        self._walk = self._walk_of(
            visibility=Visibility(problem.scene),
            lights=self.lights,
            max_edges=dr.opaque(mi.UInt32, settings.max_bounces if settings.max_bounces >= 0 else 1 << 30),
            # The absorbed flux is estimated where roulette ends a path, so roulette applies from the first hit on.
            rr_depth=1 if keep is Keep.ABSORBED else settings.rr_depth,
            keep=keep,
            after=dr.opaque(mi.UInt32, settings.after),
            specular=settings.specular,
            scheme=self._emission(seed),
            proposal=scatter_light if settings.bsdf_sampling else scatter_light_uniform,
        )

    def _walk_of(self, **options: Any) -> ParticleWalk:
        return ParticleWalk(**options)

    def _emission(self, seed: int) -> EmissionScheme:
        settings = self.settings
        if settings.emission != "importance":
            schemes: dict[str, EmissionScheme] = {"power": emit, "uniform": UniformLights(), "blind": BlindEmission()}
            return schemes[settings.emission]
        camera = CameraSampler(self.problem)
        if not camera.can_splat:
            raise UnsupportedError(
                "points cannot be connected to this sensor, so that nobody knows what it sees: use another emission "
                "than importance"
            )
        pilot = ImportancePilot(
            visibility=Visibility(self.problem.scene),
            lights=self.lights,
            max_edges=dr.opaque(mi.UInt32, settings.max_bounces if settings.max_bounces >= 0 else 1 << 30),
            rr_depth=settings.rr_depth,
            camera=camera,
        )
        return pilot.learn(settings.pilot, seed, settings.defence)

    @property
    def surfaces(self) -> Surfaces:
        """The shapes of the scene."""
        return self._table.surfaces

    @property
    def samples_per_iteration(self) -> int:
        """Light paths of a pass."""
        if self.settings.samples_per_pass:
            return min(int(self.settings.samples_per_pass), MOST_LIGHT_LANES)
        particles = float(_PASS_PARTICLES)
        if self.problem.memory:
            particles = min(particles, _MEMORY_SHARE * self.problem.memory / _BYTES)
        return max(1, min(int(particles / self.per_path), _PASS_PATHS))

    def paths_for(self, particles: int) -> int:
        """Light paths that leave about this number of particles."""
        return max(1, math.ceil(particles / self.per_path))

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """Trace the paths of a pass."""
        paths = self.samples_per_iteration
        while True:
            capacity = math.ceil(self._room * paths * _MARGIN) + _PAD
            if capacity >= _MOST_STORED:
                raise OptionError(
                    f"a pass of {paths} light paths has {self._room * paths:.3g} particles, more than {_MOST_STORED}; "
                    "lower samples_per_pass"
                )
            store, rays, bad = self._trace("", iteration, seed, paths, capacity)
            if (count := store.count) <= capacity:
                break
            self._room = count / paths
            if self.problem.memory and _BYTES * count > self.problem.memory:
                raise OptionError(f"a pass of {paths} light paths has {count} particles, too many for the memory limit")
        rows = self._in_scene(store.rows())
        counters = {PATHS: float(paths), RECORD: float(count), "rays": rays, "nonfinite": bad}
        records = {RECORD: Record.single(rows, iteration)}
        return Pass(Measurement({}, {}, Iterations.single(iteration), counters=counters, records=records), state)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture, only the numbers of paths and particles."""
        return Result({}, {name: int(measurement.counters[name]) for name in (PATHS, RECORD)})

    def particles(self, measurement: Measurement) -> Particles:
        """The particles of a measurement, their power divided by the number of paths."""
        record = measurement.records[RECORD]
        scale = 1.0 / measurement.counters[PATHS]
        return Particles.joined([Particles.of_rows(rows, scale) for rows in record])

    def _trace(
        self, role: str, iteration: int, seed: int, paths: int, capacity: int
    ) -> tuple[ParticleStore, float, float]:
        """(store, rays, non-finite particles) of the paths of a pass."""
        store = ParticleStore(capacity, self._table)
        number = dr.arange(mi.UInt32, paths)
        source = self._source(number, paths, seed, iteration, role)
        rays, bad = self._walk.trace(paths, source, number, store)
        dr.schedule(rays, bad)
        store.launch()
        return store, total(rays), total(bad)

    def _source(self, number: mi.UInt32, paths: int, seed: int, iteration: int, role: str = "") -> SampleSource:
        """Random numbers of the paths ``number`` of a pass."""
        sampler = self.settings.sampler
        kind = "independent" if sampler == "strata" else sampler
        source = path_numbers(kind, number, paths, seed, iteration, role + "light")
        if sampler == "strata":
            # Emission by importance uses the number of the light for more than the choice of the light.
            one_light = self.lights.count == 1 and self.settings.emission != "importance"
            source = StratifiedSource(source, number, paths, EMISSION[one_light:] + FIRST_BOUNCE)
        return source

    def _in_scene(self, rows: Rows) -> Rows:
        """Rows of the render space in the scene's units."""
        space = self.problem.space
        if not space.is_own:
            position, power = rows[:, columns_of("position")], rows[:, columns_of("power")]
            position[:] = space.to_scene(position.view(np.float32)).astype(np.float32).view(np.uint32)
            power[:] = (power.view(np.float32) / np.float32(space.scale) ** 2).view(np.uint32)
        return rows
