r"""Path tracing from the camera: the reference that every other method is tested against.

Estimator [Kajiya 1986; Veach 1997, ch. 9 and 10], one camera path of vertices z_0 (sensor), z_1, z_2, ...:

.. math:: L = \sum_j \alpha_j \left( w^e_j L_e(z_j) + w^d_j f_s(z_j) |cos| L_e(y) / p(y) \right)

with the throughput alpha_j, emission where the path hits a light, and one light point y drawn at each vertex. Three
modes: ``naive`` counts hits only, ``next_event`` counts light points wherever one can be drawn and hits elsewhere,
``mis`` weighs both by the balance or power heuristic.

Limits: a point or spot light seen through glass or in a mirror cannot be found at all, a small one only by chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource, setting
from etendue.transport import CameraPath, DirectWeights, Proposal, Walker, scatter_camera, scatter_uniform

from .base import CameraSettings, ImageMethod, ImageSettings, Layer, total


@dataclass(frozen=True)
class PathSettings(CameraSettings):
    """Settings of ``path``."""

    mode: str = setting(
        "mis", "how lights are found: by hits, by next event, or by both", choices=("naive", "next_event", "mis")
    )
    heuristic: str = setting("balance", "weights of mode mis", choices=("balance", "power"))
    bsdf_sampling: bool = setting(True, "draw directions by the materials; else uniformly, as a study may want")

    @property
    def direct_weights(self) -> DirectWeights:
        """w^e and w^d."""
        return DirectWeights(self.mode, self.heuristic)

    @property
    def proposal(self) -> Proposal:
        """Samples directions."""
        return scatter_camera if self.bsdf_sampling else scatter_uniform


class Path(ImageMethod):
    """Path tracing with next event estimation and multiple importance sampling."""

    name: ClassVar[str] = "path"
    plugin: ClassVar[str | None] = ""
    Settings: ClassVar[type[ImageSettings]] = PathSettings
    citations: ClassVar[tuple[str, ...]] = ("Kajiya1986", "Veach1997")

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.camera_numbers(lanes, samples, seed, iteration)
        ray, importance, _ = self.camera.primary(lanes // samples, source)
        walker, weights = self.walker(Walker, proposal=self.settings.proposal), self.settings.direct_weights
        path = CameraPath.start(ray, walker.max_edges)
        path = walker.walk(path, lambda s: _edge(s, walker, weights, source), "path")
        radiance, bad = self.kept(path.radiance * importance)
        dr.eval(radiance, path.rays, bad)  # one kernel; the sums below would launch it once each
        counters = {"rays": total(path.rays), "paths": float(len(lanes)), "nonfinite": total(bad)}
        return {"image": self.image(radiance, seed, iteration)}, counters


def _edge(s: CameraPath, walker: Walker, weights: DirectWeights, source: SampleSource) -> CameraPath:
    """The j-th term of the sum: trace the edge to z_j, and scatter there."""
    vertex = walker.arrive(s)

    # ---- Emission: alpha_j w^e_j L_e(z_j)
    hit = walker.emission(s, vertex)
    s.radiance[hit.active] += s.throughput * hit.radiance * weights.hit(s.pdf, hit.direct_pdf)
    s.active &= vertex.valid & (s.depth < walker.max_edges)

    # ---- Sample a light point y and a direction; one call of the BSDF evaluates both
    lights = [walker.light_point(vertex, source, s.active & vertex.smooth)] if weights.next_event else []
    scattered, towards = vertex.sample(source, s.active, lights)

    # ---- Next event: alpha_j w^d_j f_s(z_j) |cos| L_e(y) / p(y), if y is visible
    for light, f in zip(lights, towards, strict=True):
        contribution, visible = walker.next_event(s, vertex, light, f, weights.light_point(light, f.pdf))
        s.radiance[visible] += contribution

    # ---- Advance: alpha_j+1 = alpha_j f_s(z_j) |cos| / p_s(z_j+1), and Russian roulette
    s.pdf = walker.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
    walker.advance(s, vertex, scattered, source)
    return s
