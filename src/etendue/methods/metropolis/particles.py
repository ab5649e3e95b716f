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

from .tails import Independent, TailChains, TailState, Walked

#: Names in a measurement: the rows of particles, the states of some chains after every step, and the sums over
#: independent paths.
_ROWS, _TRACES, _SCALE, _FLUX = "particles", "traces", "scale", "flux"
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
        lights = LightTable(problem.scene)
        self._chains = TailChains(problem.scene, lights, o.max_bounces, o.step_size, o.anew)
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
        self._state = self._chains.from_independent(lanes, edges, seed, "tail bootstrap", 0)

    def _independent(self, paths: int, seed: int, role: str, iteration: int) -> Independent:
        return self._chains.independent(dr.arange(mi.UInt32, paths), seed, role, iteration)

    def _step(self, iteration: int, seed: int) -> Measurement:
        o = self.settings
        traced = min(_TRACED, o.chains)
        walked = self._chains.walk(self._state, o.steps, traced, seed, iteration)
        self._state = walked.state
        paths = max(1, o.chains * o.steps // 8)
        beside = self._independent(paths, seed, "tail scale", iteration)
        scale = np.array([beside.total.sum(), beside.direct.sum()])
        steps = float(o.chains * o.steps)
        return Measurement(
            sums={_SCALE: scale, _FLUX: beside.colour.sum(axis=0)},
            weights={_SCALE: float(paths), _FLUX: float(paths)},
            iterations=Iterations.single(iteration),
            squares={_SCALE: scale**2},
            counters={
                "steps": steps,
                "accepted": walked.accepted,
                "rays": walked.rays + walked.rebuilt + beside.rays,
                "step_rays": walked.rays,
                "nonfinite": walked.bad,
            },
            records={
                _ROWS: Record.single(self._shapes.rows(walked, o.chains), iteration),
                _TRACES: Record.single(np.array(walked.traces).reshape(o.steps, traced * 4), iteration),
            },
        )

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
                "flux": flux * steps,
                "flux_error": error * steps,
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
        share = diagnose(self.traces(measurement)[:, :, 0] == 1.0)
        relative = math.hypot(
            math.sqrt(variance[1]) / direct, self._all_chains(share) / self._direct_share(measurement)
        )
        flux = float(direct) / (self._direct_share(measurement) * steps)
        return flux, relative * flux

    def particles(self, measurement: Measurement) -> Iterator[Particles]:
        """The particles of each pass. ``path`` is the number of the chain."""
        flux, _ = self.flux_per_step(measurement)
        for rows in measurement.records[_ROWS]:
            yield unpacked(rows, flux)[0]

    def repeats(self, measurement: Measurement) -> Iterator[NDArray[np.uint32]]:
        """Steps for which the chains stayed at each of the particles of each pass."""
        return (rows[:, -1].copy() for rows in measurement.records[_ROWS])

    def traces(self, measurement: Measurement) -> Array:
        """(chains, steps, 4): number of edges and end of the path of the first chains after every step."""
        parts = [np.asarray(rows, np.float64).reshape(len(rows), -1, 4) for rows in measurement.records[_TRACES]]
        joined: Array = np.concatenate(parts).swapaxes(0, 1)
        return joined

    def diagnosis(self, measurement: Measurement) -> dict[str, ChainDiagnosis]:
        """Diagnosis of the number of edges and of the end of the path, along the first chains."""
        traces = self.traces(measurement)
        return {name: diagnose(traces[:, :, i]) for i, name in enumerate(QUANTITIES)}

    def _direct_share(self, measurement: Measurement) -> float:
        """Share of the steps whose path has one edge."""
        direct = sum(int(rows[rows[:, -2] == 1, -1].sum()) for rows in measurement.records[_ROWS])
        return float(direct / measurement.counters["steps"])

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
        self._state = TailState(
            copied_to_device(mi.UInt32, length), copied_to_device(mi.Float, first), copied_to_device(mi.Float, later)
        )


# ---------------------------------------------------------------------- rows of a record

#: Columns of a row, 32 bits each: position, direction, flux over its luminance, parameters on the primitive; shape,
#: primitive, chain, edges, repeats.
_COLUMNS = 16


class ShapeNumbers:
    """Numbers of the shapes of a scene, by their number in Dr.Jit's registry."""

    def __init__(self, scene: mi.Scene) -> None:
        ids = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
        self._number = np.zeros(int(ids.max()) + 1, np.uint32)
        self._number[ids] = np.arange(len(ids))
        self._is_mesh = np.array([shape.is_mesh() for shape in scene.shapes()])

    def rows(self, walked: Walked, chains: int) -> NDArray[np.uint32]:
        """The rows of the states that chains have left, in the order of the steps."""
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
        scale = dr.rcp(mi.luminance(mi.Color3f(flux.x, flux.y, flux.z)))
        numbers = [*ray.o, *ray.d, *(mi.Color3f(flux.x, flux.y, flux.z) * scale), *uv]
        shape = dr.select(instance != 0, instance, shape)
        counts = [shape, primitive, slot % chains, edges, dr.gather(mi.UInt32, walked.counts, slot)]
        dr.eval(*numbers, *counts)
        rows = np.empty((dr.width(slot), _COLUMNS), np.uint32)
        for i, column in enumerate(numbers):
            rows[:, i] = np.array(column, np.float32).view(np.uint32)
        for i, column in enumerate(counts, len(numbers)):
            rows[:, i] = np.array(column)
        rows[:, len(numbers)] = self._number[rows[:, len(numbers)]]
        return rows


def unpacked(rows: NDArray[np.uint32], flux: float) -> tuple[Particles, NDArray[np.uint32]]:
    """(the particles of rows, where a step stands for ``flux``; repeats of each)."""
    numbers = np.ascontiguousarray(rows[:, :11]).view(np.float32)
    shape, primitive, chain, edges, repeats = rows[:, 11:].T
    return (
        Particles(
            position=numbers[:, 0:3],
            direction=numbers[:, 3:6],
            power=numbers[:, 6:9] * (flux * repeats[:, None]).astype(np.float32),
            shape=shape,
            primitive=primitive,
            uv=numbers[:, 9:11],
            path=chain,
            bounce=edges,
        ),
        repeats,
    )
