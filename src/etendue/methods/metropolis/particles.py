r"""Metropolis particle tracing: ends of light paths, by Markov chains that change the last edge of a path.

Estimator [Leeson 2001, sec. 5.7.1]: with chains of states distributed as the luminance of the incident flux (see
:mod:`.tails`), N states in all, and the luminance b of the flux at all ends of all paths,

.. math:: \Phi(A) = \frac{b}{N} \sum_{i: x_i \in A} \frac{f(x_i)}{\mathrm{lum}\, f(x_i)}

is the flux that arrives on a surface A. All particles have the same luminance. b is estimated by independent paths, or
from the share of the chains' states that are ends of first edges, whose flux is known better (``scale``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import (
    Array,
    Carrying,
    CheckpointError,
    Iterations,
    Measurement,
    Method,
    OptionError,
    Record,
    Result,
    SceneError,
    Settings,
    State,
    copied_to_device,
    free_memory,
    logger,
    on_device,
    setting,
)
from etendue.integration import ChainDiagnosis, diagnose
from etendue.particles import Particles, Rows, Surfaces, SurfaceTable, columns_of
from etendue.scene import LightTable, Problem, refuse_one_way, require_rgb
from etendue.transport import scatter_light, scatter_light_uniform

from .lightpaths import Independent, LightPaths, PathNumbers
from .tails import SLOT_BYTES, TailChains, Walked, unpacked

#: Names in a measurement: rows of particles, the number of steps by which their power is to be divided, the repeats of
#: each, the states of some chains after every step, and the sums over independent paths.
RECORD, PATHS, _REPEATS, _TRACES, _SCALE = "particles", "paths", "repeats", "traces", "scale"
#: Chains whose states are recorded after every step.
_TRACED = 64
#: What is recorded of them.
QUANTITIES = ("edges", "x", "y", "z")
#: Least passes of a run: their spread gives the error of the flux. Least steps of a chain in a pass.
LEAST_PASSES, _SHORTEST = 4, 8
#: Share of the flux in the last bounce from which on a warning is given.
_MUCH_AT_THE_END = 0.002


@dataclass(frozen=True)
class MetropolisParticlesSettings(Settings):
    """Settings of ``metropolis_particles``."""

    chains: int = setting(4096, "chains side by side", minimum=1, maximum=1 << 20)
    steps: int = setting(256, "steps of each chain in a pass", minimum=8, maximum=1 << 16)
    step_size: float = setting(
        0.1, "largest move of a random number of the last edge, of the range [0, 1]", above=0.0, maximum=1.0
    )
    anew: float = setting(
        0.1,
        "probability with which a step that moves the end of a path draws the numbers of its last edge anew",
        minimum=0.0,
        maximum=1.0,
    )
    max_bounces: int = setting(
        32, "most edges of a light path; light that arrives later is left out", minimum=1, maximum=256
    )
    bootstrap: int = setting(
        1 << 16, "independent light paths from which the chains start", minimum=64, maximum=1 << 24
    )
    bsdf_sampling: bool = setting(
        True, "sample directions from the material; false: uniformly over sphere or hemisphere, for experiments"
    )
    specular: bool = setting(False, "also keep hits on surfaces without a diffuse or glossy part")
    scale: str = setting(
        "traced",
        "the flux of a particle: from independent light paths, an eighth as many as steps (traced), or from the share "
        "of direct light among the particles (counted)",
        choices=("traced", "counted"),
    )

    def for_budget(self, steps: int, given: Mapping[str, Any]) -> MetropolisParticlesSettings:
        """Settings with passes so small that a run of ``steps`` has some, unless ``steps`` or ``chains`` are
        ``given``."""
        one = max(1, steps // LEAST_PASSES)
        if {"steps", "chains"} & given.keys() or one >= self.chains * self.steps:
            return self
        length = min(max(one // self.chains, _SHORTEST), self.steps)
        return self.replace(steps=length, chains=min(max(one // length, 1), self.chains))


class MetropolisParticles(Carrying, Method):
    """Light paths as steps of Markov chains: particles of equal luminance.

    A pass is ``steps`` steps of all chains, which are distributed as the incident flux. A state that a chain
    repeats is one particle with that many times the power. A measurement has the record ``particles``
    (:data:`etendue.particles.Rows`, whose power is not divided by the number of steps) and the counter ``paths``, the
    number of steps, as measurements of :class:`~etendue.methods.ParticleTracing` do.
    """

    name: ClassVar[str] = "metropolis_particles"
    counts: ClassVar[str] = "paths"
    Settings: ClassVar[type[Settings]] = MetropolisParticlesSettings
    citations: ClassVar[tuple[str, ...]] = ("Leeson2001", "Metropolis1953")
    carries_on: ClassVar[bool] = True
    has_fast_noise: ClassVar[bool] = False

    def __init__(self, settings: MetropolisParticlesSettings | None = None) -> None:
        self.settings: Any = settings or MetropolisParticlesSettings()

    # ------------------------------------------------------------------ the protocol of methods

    @property
    def samples_per_iteration(self) -> int:
        """Steps of a pass, of all chains."""
        return int(self.settings.chains * self.settings.steps)

    @property
    def surfaces(self) -> Surfaces:
        """The shapes of the scene."""
        return self._maker.surfaces

    def paths_for(self, particles: int) -> int:
        """Steps that leave this number of particles, repeats included."""
        return particles

    def prepare(self, problem: Problem, seed: int) -> None:
        """Trace independent paths, and start the chains at some of their ends, in proportion to the flux there.

        Raises :class:`SceneError` if no light arrives anywhere, :class:`OptionError` if the states of a pass do not fit
        into memory.
        """
        self._forget_states()
        o = self.settings
        slots = o.chains * (o.steps + 1)
        needed = SLOT_BYTES * slots
        if 4 * slots >= 1 << 32 or needed > (problem.memory or free_memory() or math.inf):
            raise OptionError(
                f"a pass of {o.chains} chains with {o.steps} steps needs {needed / 1e6:.0f} MB, too much for the "
                "memory or for 32-bit numbers; lower steps (more passes do the same) or chains"
            )
        require_rgb("particles")
        refuse_one_way(problem.scene, "the tracing of particles")
        self.problem, self.scene = problem, problem.scene
        proposal = scatter_light if o.bsdf_sampling else scatter_light_uniform
        self._paths = LightPaths(problem.scene, LightTable(problem.scene), o.max_bounces, proposal)
        self._chains = TailChains(self._paths, o.step_size, o.anew)
        self._maker = _RowMaker(problem)
        pilot = self._independent(o.bootstrap, seed, "tail bootstrap", 0)
        total = pilot.total.sum()
        if not total > 0.0:
            raise SceneError(
                f"none of {o.bootstrap} light paths from the emitters of '{problem.source}' arrives at a surface with "
                "light; look at the lights, or trace more (bootstrap)"
            )
        late = pilot.last.sum() / total
        if late > _MUCH_AT_THE_END:
            logger.warning(
                "%.1f %% of the flux arrives at bounce %d, the last one: later light is missing; raise max_bounces",
                100 * late,
                o.max_bounces,
            )
        # Evenly spaced places in the sum: a start is picked as often as its share, rounded up or down.
        places = (np.arange(o.chains) + 0.5) / o.chains * total
        picked = np.minimum(np.searchsorted(np.cumsum(pilot.total), places, side="right"), o.bootstrap - 1)
        lanes = copied_to_device(mi.UInt32, picked.astype(np.uint32))
        edges = copied_to_device(mi.UInt32, pilot.edges[picked])
        self._state = self._paths.from_independent(lanes, edges, seed, "tail bootstrap", 0)
        #: Number of independent paths, sums of the luminance at all and at first ends; number of steps, of all and at
        #: first ends.
        self._known = np.array([o.bootstrap, total, pilot.direct.sum(), 0.0, 0.0])

    def _independent(self, paths: int, seed: int, role: str, iteration: int) -> Independent:
        return self._paths.independent(dr.arange(mi.UInt32, paths), seed, role, iteration)

    def _step(self, iteration: int, seed: int) -> Measurement:
        o = self.settings
        traced = min(_TRACED, o.chains)
        walked = self._chains.walk(self._state, o.steps, traced, seed, iteration)
        self._state = walked.state
        paths = max(1, o.chains * o.steps // 8)
        beside = self._independent(paths, seed, "tail scale", iteration)
        rows, repeats, smooth, direct = self._maker.rows(walked, o.chains)
        steps = float(o.chains * o.steps)
        of_paths = np.array([beside.total.sum(), beside.direct.sum()])
        self._known = self._known + np.array([paths, *of_paths, steps, direct])
        lost = steps - float(repeats.sum(dtype=np.float64))
        if not o.specular:
            rows, repeats = rows[smooth], repeats[smooth]
        power = rows[:, columns_of("power")]
        scale = self._flux() / self.problem.space.scale**2
        power[:] = (power.view(np.float32) * np.float32(scale)).view(np.uint32)
        return Measurement(
            sums={_SCALE: of_paths},
            weights={_SCALE: float(paths)},
            iterations=Iterations.single(iteration),
            squares={_SCALE: of_paths**2},
            counters={
                PATHS: steps,
                RECORD: float(len(rows)),
                "direct_steps": direct,
                "accepted": walked.accepted,
                "rays": walked.rays + walked.rebuilt + beside.rays,
                "step_rays": walked.rays,
                "nonfinite": walked.bad,
                "lost_steps": lost,
            },
            records={
                RECORD: Record.single(rows, iteration),
                _REPEATS: Record.single(repeats, iteration),
                _TRACES: Record.single(np.array(walked.traces).reshape(o.steps, traced * 4), iteration),
            },
        )

    def _flux(self) -> float:
        """b, the luminance of the flux at all ends, as it is known now."""
        paths, total, direct, steps, direct_steps = self._known
        if self.settings.scale == "traced" or not direct_steps:
            return float(total / paths)
        return float(direct / paths * steps / direct_steps)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture: the flux at all ends with its standard error, and the diagnosis of the chains."""
        flux, error = self.flux(measurement)
        steps = measurement.counters[PATHS]
        diagnosis = self.diagnosis(measurement)
        effective = min(d.effective_samples for d in diagnosis.values())
        metadata = {
            "method": self.name,
            "settings": self.settings.to_dict(),
            "particles": len(measurement.records[RECORD]),
            "flux": flux,
            "flux_error": error,
            "acceptance": measurement.counters["accepted"] / steps,
            "rays_per_step": measurement.counters["step_rays"] / steps,
            "autocorrelation_time": {name: d.autocorrelation_time for name, d in diagnosis.items()},
            "effective_samples": effective * self.settings.chains / min(_TRACED, self.settings.chains),
            "r_hat": max(d.r_hat for d in diagnosis.values()),
        }
        return Result({}, metadata)

    def noise(self, measurement: Measurement) -> float | None:
        """Squared relative standard error of the flux at all ends; ``None`` if it is not known yet."""
        if _SCALE not in measurement.sums:
            return None
        flux, error = self.flux(measurement)
        return None if math.isnan(error) else (error / flux) ** 2

    # ------------------------------------------------------------------ results of a measurement

    def flux(self, measurement: Measurement) -> tuple[float, float]:
        """(luminance of the flux at all ends, in the scene's units; its standard error in the power of particles).
        The error is NaN for fewer than two passes.

        The power of the particles of a pass is by the estimate of the flux up to this pass. Its mean over many passes
        has twice the variance of the last estimate."""
        (total, direct), variance = measurement.mean(_SCALE), 2.0 * measurement.variance_of_mean(_SCALE)
        scale = self.problem.space.scale**2
        if self.settings.scale == "traced":
            return float(total) / scale, math.sqrt(variance[0]) / scale
        share = measurement.counters["direct_steps"] / measurement.counters[PATHS]
        spent = diagnose(self.traces(measurement)[:, :, 0] == 1.0)
        # Only some of the chains were diagnosed.
        of_share = spent.standard_error * math.sqrt(2.0 * min(_TRACED, self.settings.chains) / self.settings.chains)
        flux = float(direct) / share / scale
        return flux, flux * math.hypot(math.sqrt(variance[1]) / direct, of_share / share)

    def particles(self, measurement: Measurement) -> Particles:
        """The particles of a measurement. ``path`` is the number of the chain."""
        scale = 1.0 / measurement.counters[PATHS]
        return Particles.joined([Particles.of_rows(rows, scale) for rows in measurement.records[RECORD]])

    def repeats(self, measurement: Measurement) -> NDArray[np.uint32]:
        """Steps for which the chains stayed at each of the particles."""
        return np.concatenate(list(measurement.records[_REPEATS]))

    def traces(self, measurement: Measurement) -> Array:
        """(chains, steps, 4): number of edges and end of the path of the first chains after every step."""
        parts = [np.asarray(rows, np.float64).reshape(len(rows), -1, 4) for rows in measurement.records[_TRACES]]
        joined: Array = np.concatenate(parts).swapaxes(0, 1)
        return joined

    def diagnosis(self, measurement: Measurement) -> dict[str, ChainDiagnosis]:
        """Diagnosis of the number of edges and of the end of the path, along the first chains."""
        traces = self.traces(measurement)
        return {name: diagnose(traces[:, :, i]) for i, name in enumerate(QUANTITIES)}

    # ------------------------------------------------------------------ states

    def _left(self) -> State:
        s = self._state
        return {"length": s.length, "first": s.first, "later": s.later, "known": self._known}

    def _take(self, state: State) -> None:
        o = self.settings
        length, first, later = (
            np.asarray(state[name], kind).ravel()
            for name, kind in (("length", np.uint32), ("first", np.float32), ("later", np.float32))
        )
        sizes = o.chains, 5 * o.chains, max(1, 3 * (o.max_bounces - 1) * o.chains)
        if (len(length), len(first), len(later)) != sizes or not 1 <= length.min() <= length.max() <= o.max_bounces:
            raise CheckpointError("the chains in the checkpoint do not fit these settings; start a new run")
        self._state = PathNumbers(
            copied_to_device(mi.UInt32, length), copied_to_device(mi.Float, first), copied_to_device(mi.Float, later)
        )
        self._known = np.asarray(state["known"], np.float64)


# ---------------------------------------------------------------------- rows of a record


class _RowMaker:
    """Makes rows of particles of the states that chains have left."""

    def __init__(self, problem: Problem) -> None:
        self._space = problem.space
        table = SurfaceTable(problem)
        self.surfaces = table.surfaces
        self._number = table.number_of_pointer
        self._is_mesh = on_device(mi.UInt32, table.is_mesh_pointer.astype(np.uint32))
        self._first = on_device(mi.UInt32, table.first_of_pointer)
        self._all_meshes = all(table.is_mesh_pointer[1:])
        shapes = problem.scene.shapes()
        #: Whether the shapes have a diffuse or glossy part, except those inside groups.
        self._is_smooth = np.array([mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth) for shape in shapes])

    def rows(self, walked: Walked, chains: int) -> tuple[Rows, NDArray[np.uint32], NDArray[np.bool_], float]:
        """(rows in the order of the steps, whose power has the repeats as its luminance; repeats; whether the surface
        has a diffuse or glossy part; steps spent at the end of first edges)."""
        slot = dr.compress(walked.counts > 0)
        position, direction, flux = (
            dr.gather(mi.Vector4f, array, slot) for array in (walked.position, walked.direction, walked.flux)
        )
        shape, instance, primitive, both = dr.gather(mi.Vector4u, walked.what, slot)
        edges, bounce = unpacked(both)
        ray = mi.Ray3f(
            mi.Point3f(position.x, position.y, position.z), mi.Vector3f(direction.x, direction.y, direction.z)
        )
        uv, smooth_inside = mi.Point2f(position.w, direction.w), dr.full(mi.Bool, False, dr.width(slot))
        if not self._all_meshes:
            # The preliminary intersection of other shapes has neither their parameters nor the shape in a group.
            hit = dr.zeros(mi.PreliminaryIntersection3f, dr.width(slot))
            hit.valid = dr.full(mi.Bool, True, dr.width(slot))
            hit.shape, hit.instance = (dr.reinterpret_array(mi.ShapePtr, number) for number in (shape, instance))
            hit.shape_index = dr.reinterpret_array(mi.UInt32, flux.w)
            hit.prim_uv, hit.prim_index, hit.t = uv, primitive, mi.Float(0.0)
            other = dr.gather(mi.UInt32, self._is_mesh, shape) == 0
            si = hit.compute_surface_interaction(ray, active=other)
            inner = dr.select(other, dr.reinterpret_array(mi.UInt32, si.shape), shape)
            is_mesh = dr.gather(mi.UInt32, self._is_mesh, inner) != 0
            uv = dr.select(is_mesh, uv, si.uv)
            smooth_inside = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
            primitive = dr.gather(mi.UInt32, self._first, inner) + dr.select(is_mesh, primitive, 0)
        repeats = dr.gather(mi.UInt32, walked.counts, slot)
        colour = mi.Spectrum(flux.x, flux.y, flux.z)
        colour *= mi.Float(repeats) / mi.luminance(colour)
        whole = {
            "shape": dr.select(instance != 0, instance, shape),
            "primitive": primitive,
            "path": slot % chains,
            "bounce": bounce,
        }
        real = {"position": ray.o, "direction": ray.d, "power": colour, "uv": uv}
        dr.eval(repeats, whole, real, edges, smooth_inside)
        result = np.empty((dr.width(slot), columns_of("bounce").stop), np.uint32)
        for name, values in real.items():
            numbers = np.array(dr.ravel(values), np.float32).reshape(len(result), -1)
            if name == "position" and not self._space.is_own:
                numbers = self._space.to_scene(numbers).astype(np.float32)
            result[:, columns_of(name)] = numbers.view(np.uint32)
        for name, values in whole.items():
            result[:, columns_of(name).start] = np.array(values)
        number = self._number[result[:, columns_of("shape").start]]
        result[:, columns_of("shape").start] = number
        smooth = np.where(np.array(instance) != 0, np.array(smooth_inside), self._is_smooth[number])
        counts = np.array(repeats)
        return result, counts, smooth, float(counts[np.array(edges) == 1].sum(dtype=np.float64))
