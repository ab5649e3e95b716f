r"""Path tracing from the camera: the reference against which all other methods are tested.

Estimator [Kajiya 1986; Veach 1997, ch. 9 and 10], one camera path of vertices z_0 (sensor), z_1, z_2, ...:

.. math:: L = \sum_j \alpha_j \left( w^e_j L_e(z_j) + w^d_j f_s(z_j) |cos| L_e(y) / p(y) \right)

with the throughput alpha_j, emission L_e(z_j) where the path hits a light, and one light point y sampled at each
vertex. Three modes: ``naive`` uses hits only, ``next_event`` uses light points wherever one can be sampled and hits
elsewhere, ``mis`` weights both by the balance or power heuristic.

Limits: light of a point or spot light through glass or mirrors is not found; that of a small light is found rarely.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource, Settings, setting
from etendue.film import Component
from etendue.scene import Problem
from etendue.transport import CameraPath, DirectWeights, FirstHits, Proposal, Walker, scatter_camera, scatter_uniform

from .base import CameraSettings, ImageMethod, ImageSettings, Layer, total
from .ending import EndingSettings, EndsInMap
from .openings import OpeningSettings, is_short, through_openings

#: Traces paths along camera rays, as :meth:`Path.trace`.
Trace: TypeAlias = "Callable[[mi.Ray3f, SampleSource, FirstHits | None], CameraPath]"


#: Factor on the probability of surviving roulette in media that scatter, where paths are long and carry similar light.
_IN_FOG = 2.0


@dataclass(frozen=True)
class DirectionSettings(Settings):
    """Settings of the methods that can sample directions without the material."""

    bsdf_sampling: bool = setting(
        True, "sample directions from the material; false: uniformly over sphere or hemisphere, with more noise"
    )

    @property
    def proposal(self) -> Proposal:
        """The function that samples directions of camera paths."""
        return scatter_camera if self.bsdf_sampling else scatter_uniform


@dataclass(frozen=True)
class PathSettings(DirectionSettings, CameraSettings):
    """Settings of the path tracers."""

    mode: str = setting(
        "mis",
        "techniques for light: paths that hit a light (naive), points sampled on lights (next_event), or both, "
        "combined by multiple importance sampling (mis)",
        choices=("naive", "next_event", "mis"),
    )
    heuristic: str = setting(
        "balance",
        "heuristic of the weights of mode=mis: balance, or power with exponent 2",
        choices=("balance", "power"),
    )

    @property
    def direct_weights(self) -> DirectWeights:
        """The weights w^e and w^d."""
        return DirectWeights(self.mode, self.heuristic)


@dataclass(frozen=True)
class EndingPathSettings(EndingSettings, PathSettings):
    """Settings of the path tracers that can end in maps."""


@dataclass(frozen=True)
class WindowPathSettings(OpeningSettings, EndingPathSettings):
    """Settings of ``path`` and ``guided``, whose next event looks for windows."""

    openings: bool = setting(
        True, "where walls hide most of the sky, find windows by camera paths, and sample the sky through them"
    )

    @property
    def samples_sky(self) -> bool:
        """See :class:`OpeningSettings`."""
        return self.mode != "naive"

    @property
    def has_light_paths(self) -> bool:
        """See :class:`OpeningSettings`."""
        return False


class Path(EndsInMap):
    """Path tracing with next event estimation and multiple importance sampling."""

    name: ClassVar[str] = "path"
    plugin: ClassVar[str | None] = ""
    Settings: ClassVar[type[ImageSettings]] = WindowPathSettings
    settings: PathSettings
    citations: ClassVar[tuple[str, ...]] = ("Kajiya1986", "Veach1997", "Bitterli2015")
    media: ClassVar[str | None] = "scattering"
    spectral: ClassVar[bool] = True
    one_way = True
    measures: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`."""
        super().prepare(problem, seed)
        self._seed, self._has_looked = seed, False

    def plan(self, seconds: float | None, passes: int | None, error: float | None) -> None:
        """See :class:`Method`. Looks for windows, unless the run is too short for it."""
        if not self._has_looked and not is_short(self, seconds, passes):
            self.lights, self._has_looked = through_openings(self, self._seed), True

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`. Twice as many: a pass is short, and its fixed cost counts."""
        return 2 * super().full_lanes()

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        return path_pass(self, iteration, seed, samples, self.trace)

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        dr.eval(camera_paths(self, lanes, iteration, seed, samples, self.trace).radiance)

    def trace(self, ray: mi.Ray3f, source: SampleSource, first: FirstHits | None = None) -> CameraPath:
        """See :func:`trace_path`."""
        return trace_path(self, ray, source, first)


def trace_path(method: EndsInMap, ray: mi.Ray3f, source: SampleSource, first: FirstHits | None = None) -> CameraPath:
    """Camera paths that begin with ``ray``, in their final state, of a method with :class:`PathSettings`; their first
    hits are added to ``first``."""
    settings: Any = method.settings
    survival = _IN_FOG if method.visibility.volumes else Walker.survival
    walker = method.walker(Walker, proposal=settings.proposal, first=first, survival=survival)
    path = traced(ray, walker, settings.direct_weights, source, **method.path_fields())
    if (light := method.light_of_map(path)) is not None:
        path.add(light, mi.Bool(True), Component.INDIRECT)
    return path


def path_pass(
    method: ImageMethod,
    iteration: int,
    seed: int,
    samples: int,
    trace: Trace,
) -> tuple[dict[str, Layer], dict[str, float]]:
    """``render_pass`` of a method by camera paths; ``trace``: as :meth:`Path.trace`."""
    lanes = dr.arange(mi.UInt32, method.camera.pixels * samples)
    dr.eval(lanes)  # so that any of them shares the kernel
    radiance, rays, bad = light_of_paths(method, lanes, iteration, seed, samples, trace)
    counters = {"rays": total(rays), "paths": float(len(lanes)), "nonfinite": total(bad)}
    return method.images(radiance, seed, iteration), counters


def light_of_paths(
    method: ImageMethod, lanes: mi.UInt32, iteration: int, seed: int, samples: int, trace: Trace
) -> tuple[dict[str, mi.Color3f], mi.UInt32, mi.Bool]:
    """(layers of the light of the camera paths ``lanes`` of a pass, their rays, mask of those that were not finite),
    evaluated in one kernel; arguments as of :func:`path_pass`."""
    path = camera_paths(method, lanes, iteration, seed, samples, trace)
    radiance, bad = method.kept_layers(path)
    dr.eval(radiance, path.rays, bad)
    return radiance, path.rays, bad


def camera_paths(
    method: ImageMethod, lanes: mi.UInt32, iteration: int, seed: int, samples: int, trace: Trace
) -> CameraPath:
    """The camera paths ``lanes`` of a pass, not yet evaluated; arguments as of :func:`path_pass`."""
    source = method.camera_numbers(lanes, samples, seed, iteration)
    ray, importance, _ = method.camera.primary(lanes // dr.opaque(mi.UInt32, samples), source)
    path = trace(ray, source, method.first_hits(lanes, iteration))
    path.weigh(importance)
    return path


def traced(ray: mi.Ray3f, walker: Walker, weights: DirectWeights, source: SampleSource, **own: Any) -> CameraPath:
    """Paths that begin with ``ray``, in their final state. ``own``: see :meth:`CameraPath.start`."""
    path = CameraPath.start(ray, walker.max_edges, **own)
    return walker.walk(path, lambda s: edge(s, walker, weights, source), "path")


def edge(s: CameraPath, walker: Walker, weights: DirectWeights, source: SampleSource) -> CameraPath:
    """The j-th term of the sum: trace the edge to z_j, and scatter."""
    vertex = walker.arrive(s, source)

    # ---- Emission: alpha_j w^e_j L_e(z_j)
    hit = walker.emission(s, vertex)
    s.add(s.throughput * hit.radiance * weights.hit(s.pdf, hit.direct_pdf), hit.active, s.seen)
    s.active &= vertex.valid & walker.goes_on(s, vertex)

    # ---- Sample a light point y and a direction; one call of the BSDF for both
    lights = [walker.light_point(vertex, source, s.active & vertex.smooth)] if weights.next_event else []
    scattered, evaluated = vertex.sample(source, s.active, lights)

    # ---- Next event: alpha_j w^d_j f_s(z_j) |cos| L_e(y) / p(y), if y is visible
    for light, f in zip(lights, evaluated, strict=True):
        contribution, visible = walker.next_event(s, vertex, light, f, weights)
        s.add(contribution, visible, s.lit)

    # ---- Advance: alpha_j+1 = alpha_j f_s(z_j) |cos| / p_s(z_j+1), and Russian roulette
    s.pdf = walker.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
    walker.advance(s, vertex, scattered, source)
    return s
