r"""Metropolis particle tracing: ends of light paths, by Markov chains that change the last edge of a path.

Estimator [Leeson 2001, sec. 5.7.1]: with chains of states distributed as the luminance of the incident flux (see
:mod:`.tails`), N states in all, and the luminance b of the flux at all ends of all paths,

.. math:: \Phi(A) = \frac{b}{N} \sum_{i: x_i \in A} \frac{f(x_i)}{\mathrm{lum}\, f(x_i)}

is the flux that arrives on a surface A. All particles have the same luminance. b is estimated by independent paths, or
from the share of the chains' states that are ends of first edges, whose flux is known better (``scale``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
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
    Record,
    Result,
    SceneError,
    Settings,
    State,
    copied_to_device,
    logger,
    setting,
)
from etendue.integration import ChainDiagnosis, diagnose
from etendue.particles import Particles
from etendue.scene import LightTable, Problem

from .lightpaths import Independent, LightPaths, PathNumbers
from .tails import TailChains, Walked

#: Names in a measurement: the rows of particles, the states of some chains after every step, and the sums over
#: independent paths.
_ROWS, _REPEATS, _TRACES, _SCALE, _FLUX = "particles", "repeats", "traces", "scale", "flux"
#: Chains whose states are recorded after every step.
_TRACED = 64
#: What is recorded of them.
QUANTITIES = ("edges", "x", "y", "z")
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
    specular: bool = setting(False, "also keep hits on surfaces without a diffuse or glossy part")
    scale: str = setting(
        "traced",
        "the flux of a particle: from independent light paths, an eighth as many as steps (traced), or from the share "
        "of direct light among the particles (counted)",
        choices=("traced", "counted"),
    )


class MetropolisParticles(Carrying):
    """Particles of equal luminance by Markov chains; implements ``core.Method``.

    A pass is ``steps`` steps of all chains, which are distributed as the incident flux. A chain's repeats of a state
    are one particle with so many times the power. Measurements hold the particles as a record without their common
    factor, which :meth:`particles` supplies.
    """

    name: ClassVar[str] = "metropolis_particles"
    Settings: ClassVar[type[Settings]] = MetropolisParticlesSettings
    citations: ClassVar[tuple[str, ...]] = ("Leeson2001", "Metropolis1953")
    carries_on: ClassVar[bool] = True

    def __init__(self, settings: MetropolisParticlesSettings | None = None) -> None:
        self.settings: Any = settings or MetropolisParticlesSettings()

    # ------------------------------------------------------------------ the protocol of methods

    @property
    def samples_per_iteration(self) -> int:
        """Steps of a pass, of all chains."""
        return int(self.settings.chains * self.settings.steps)

    def prepare(self, problem: Problem, seed: int) -> None:
        """Trace independent paths, and start the chains at some of their ends, in proportion to the flux there.

        Raises :class:`SceneError` if no light arrives anywhere.
        """
        self._forget_states()
        o = self.settings
        self.problem, self.scene = problem, problem.scene
        self._paths = LightPaths(problem.scene, LightTable(problem.scene), o.max_bounces)
        self._chains = TailChains(self._paths, o.step_size, o.anew)
        self._shapes = ShapeNumbers(problem.scene)
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

    def _independent(self, paths: int, seed: int, role: str, iteration: int) -> Independent:
        return self._paths.independent(dr.arange(mi.UInt32, paths), seed, role, iteration)

    def _step(self, iteration: int, seed: int) -> Measurement:
        o = self.settings
        traced = min(_TRACED, o.chains)
        walked = self._chains.walk(self._state, o.steps, traced, seed, iteration)
        self._state = walked.state
        paths = max(1, o.chains * o.steps // 8)
        beside = self._independent(paths, seed, "tail scale", iteration)
        scale = np.array([beside.total.sum(), beside.direct.sum()])
        steps = float(o.chains * o.steps)
        rows, repeats, direct = self._shapes.rows(walked, o.chains)
        if not o.specular:
            smooth = self._shapes.is_smooth[rows[:, _SHAPE]]
            rows, repeats = rows[smooth], repeats[smooth]
        return Measurement(
            sums={_SCALE: scale, _FLUX: beside.colour.sum(axis=0)},
            weights={_SCALE: float(paths), _FLUX: float(paths)},
            iterations=Iterations.single(iteration),
            squares={_SCALE: scale**2},
            counters={
                "steps": steps,
                "direct_steps": direct,
                "accepted": walked.accepted,
                "rays": walked.rays + walked.rebuilt + beside.rays,
                "step_rays": walked.rays,
                "nonfinite": walked.bad,
            },
            records={
                _ROWS: Record.single(self._in_scene(rows), iteration),
                _REPEATS: Record.single(repeats, iteration),
                _TRACES: Record.single(np.array(walked.traces).reshape(o.steps, traced * 4), iteration),
            },
        )

    def _in_scene(self, rows: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Rows of the render space in the scene's units."""
        space = self.problem.space
        if not space.is_own:
            position = rows[:, 0:3].copy().view(np.float32)
            rows[:, 0:3] = space.to_scene(position).astype(np.float32).view(np.uint32)
            rows[:, 6:9] = (rows[:, 6:9].copy().view(np.float32) / np.float32(space.scale) ** 2).view(np.uint32)
        return rows

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture: the flux of a step with its relative standard error, and the diagnosis of the chains."""
        flux, error = self.flux_per_step(measurement)
        steps = measurement.counters["steps"]
        diagnosis = self.diagnosis(measurement)
        return Result(
            {},
            {
                "method": self.name,
                "settings": self.settings.to_dict(),
                "particles": len(measurement.records[_ROWS]),
                "flux": flux * steps / self.problem.space.scale**2,
                "flux_error": error * steps / self.problem.space.scale**2,
                "acceptance": measurement.counters["accepted"] / steps,
                "rays_per_step": measurement.counters["step_rays"] / steps,
                "autocorrelation_time": {name: d.autocorrelation_time for name, d in diagnosis.items()},
                "effective_samples": self.settings.chains
                / min(_TRACED, self.settings.chains)
                * min(d.effective_samples for d in diagnosis.values()),
                "r_hat": max(d.r_hat for d in diagnosis.values()),
            },
        )

    def noise(self, measurement: Measurement) -> float | None:
        """Squared relative standard error of the flux at all ends; ``None`` if it is not known yet."""
        flux, error = self.flux_per_step(measurement)
        return None if math.isnan(error) else (error / flux) ** 2

    # ------------------------------------------------------------------ what was traced

    def flux_per_step(self, measurement: Measurement) -> tuple[float, float]:
        """(b / N, its standard error): the luminance of the flux that a step stands for. The error is NaN for fewer
        than two passes."""
        steps = measurement.counters["steps"]
        (total, direct), variance = measurement.mean(_SCALE), measurement.variance_of_mean(_SCALE)
        if self.settings.scale == "traced":
            return float(total) / steps, math.sqrt(variance[0]) / steps
        share = measurement.counters["direct_steps"] / steps
        of_share = self._all_chains(diagnose(self.traces(measurement)[:, :, 0] == 1.0))
        relative = math.hypot(math.sqrt(variance[1]) / direct, of_share / share)
        flux = float(direct) / (share * steps)
        return flux, relative * flux

    def particles(self, measurement: Measurement) -> Iterator[Particles]:
        """The particles of each pass. ``path`` is the number of the chain."""
        flux, _ = self.flux_per_step(measurement)
        for rows in measurement.records[_ROWS]:
            yield unpacked(rows, flux)

    def repeats(self, measurement: Measurement) -> Iterator[NDArray[np.uint32]]:
        """Steps for which the chains stayed at each of the particles of each pass."""
        return iter(measurement.records[_REPEATS])

    def traces(self, measurement: Measurement) -> Array:
        """(chains, steps, 4): number of edges and end of the path of the first chains after every step."""
        parts = [np.asarray(rows, np.float64).reshape(len(rows), -1, 4) for rows in measurement.records[_TRACES]]
        joined: Array = np.concatenate(parts).swapaxes(0, 1)
        return joined

    def diagnosis(self, measurement: Measurement) -> dict[str, ChainDiagnosis]:
        """Diagnosis of the number of edges and of the end of the path, along the first chains."""
        traces = self.traces(measurement)
        return {name: diagnose(traces[:, :, i]) for i, name in enumerate(QUANTITIES)}

    def _all_chains(self, diagnosis: ChainDiagnosis) -> float:
        """The standard error of a mean over all chains, of which only the first were diagnosed."""
        return diagnosis.standard_error * math.sqrt(min(_TRACED, self.settings.chains) / self.settings.chains)

    # ------------------------------------------------------------------ states

    def _left(self) -> State:
        s = self._state
        return {"length": s.length, "first": s.first, "later": s.later}

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


# ---------------------------------------------------------------------- rows of a record

#: Columns of a row of :class:`Particles`, 32 bits each, and that of the shape.
_COLUMNS, _SHAPE = 15, 9


class ShapeNumbers:
    """Numbers of the shapes of a scene, by their number in Dr.Jit's registry."""

    def __init__(self, scene: mi.Scene) -> None:
        ids = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
        self._number = np.zeros(int(ids.max()) + 1, np.uint32)
        self._number[ids] = np.arange(len(ids))
        self._is_mesh = np.array([shape.is_mesh() for shape in scene.shapes()])
        #: Whether the shapes have a diffuse or glossy part.
        self.is_smooth = np.array([mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth) for shape in scene.shapes()])

    def rows(self, walked: Walked, chains: int) -> tuple[NDArray[np.uint32], NDArray[np.uint32], float]:
        """(rows of the states that chains have left, in the order of the steps, with the power of a step of luminance 1
        times the repeats; repeats; steps at the end of first edges)."""
        slot = dr.compress(walked.counts > 0)
        position, direction, flux = (
            dr.gather(mi.Vector4f, array, slot) for array in (walked.position, walked.direction, walked.flux)
        )
        shape, instance, primitive, edges = dr.gather(mi.Vector4u, walked.what, slot)
        # The parameters of shapes other than meshes are not those of the preliminary intersection.
        hit = dr.zeros(mi.PreliminaryIntersection3f, dr.width(slot))
        hit.valid = dr.full(mi.Bool, True, dr.width(slot))
        hit.shape = dr.reinterpret_array(mi.ShapePtr, shape)
        hit.prim_uv, hit.prim_index = mi.Point2f(position.w, direction.w), primitive
        ray = mi.Ray3f(
            mi.Point3f(position.x, position.y, position.z), mi.Vector3f(direction.x, direction.y, direction.z)
        )
        uv = mi.Point2f(position.w, direction.w)
        if not self._is_mesh.all():
            other = ~hit.shape.is_mesh()
            uv = dr.select(other, hit.compute_surface_interaction(ray, mi.RayFlags.UV, active=other).uv, uv)
        repeats = dr.gather(mi.UInt32, walked.counts, slot)
        colour = mi.Color3f(flux.x, flux.y, flux.z)
        colour *= mi.Float(repeats) / mi.luminance(colour)
        shape = dr.select(instance != 0, instance, shape)
        whole = {9: shape, 10: primitive, 13: slot % chains, 14: edges}
        real = dict(enumerate([*ray.o, *ray.d, *colour])) | {11: uv.x, 12: uv.y}
        dr.eval(repeats, whole, real)
        rows = np.empty((dr.width(slot), _COLUMNS), np.uint32)
        for i, column in real.items():
            rows[:, i] = np.array(column, np.float32).view(np.uint32)
        for i, column in whole.items():
            rows[:, i] = np.array(column)
        rows[:, _SHAPE] = self._number[rows[:, _SHAPE]]
        counts = np.array(repeats)
        return rows, counts, float(counts[rows[:, -1] == 1].sum(dtype=np.float64))


def unpacked(rows: NDArray[np.uint32], scale: float) -> Particles:
    """Particles of rows, with their power times ``scale``."""
    real = rows[:, :9].copy().view(np.float32)
    shape, primitive, u, v, path, bounce = rows[:, 9:].T
    return Particles(
        position=real[:, 0:3],
        direction=real[:, 3:6],
        power=(real[:, 6:9] * np.float64(scale)).astype(np.float32),
        shape=shape,
        primitive=primitive,
        uv=np.stack([u, v], axis=1).view(np.float32),
        path=path,
        bounce=bounce,
    )
