"""What the chains of ``film_metropolis`` sample: camera paths, light paths, or both [Leeson 2001, sec. 5.7.6], and the
light that they leave out."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.integration import Layout
from etendue.transport import CameraPath, DirectWeights, LightWalk, Mis, Techniques, Walker, dimensions as dim

from ..base import keep_finite
from ..path import traced
from .bidirectional import PairTarget, SplatList
from .targets import ROULETTE, Contribution, Traced, camera_slots, light_slots, wavelengths_of

if TYPE_CHECKING:
    from .filmchains import FilmMetropolis


class _LeftOut(DirectWeights):
    """Weights of ``path`` without lights that are seen directly; a density of -1 marks edges from the camera."""

    def hit(self, pdf: mi.Float, direct_pdf: mi.Float) -> mi.Float:
        """See :class:`DirectWeights`."""
        return dr.select(pdf < 0.0, 0.0, super().hit(dr.maximum(pdf, 0.0), direct_pdf))


class FilmTarget:
    """Camera paths as of ``path``, through a film that is wider than the picture."""

    def __init__(self, method: FilmMetropolis) -> None:
        self._method: FilmMetropolis = weakref.proxy(method)  # which owns the target
        end, inner = camera_slots(method)
        vertices = method.settings.vertices
        self.layouts: Mapping[str, Layout] = {"camera": Layout(end, [*inner, ROULETTE], vertices)}

    def place(self, source: SampleSource) -> mi.Point2f:
        """A film position in pixels, uniform over the picture and its margin."""
        method, u = self._method, source.next_2d(0, dim.FILM)
        margin = dr.opaque(mi.Float, method.margin)
        x, y = (v * (1.0 + 2.0 * margin) - margin for v in u)
        return mi.Point2f(x * method.camera.width, y * method.camera.height)

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """See :class:`Target`."""
        method, source = self._method, sources["camera"]
        place = self.place(source)
        with wavelengths_of(method, source):
            ray, importance = self._primary(place, source)
            if method.seen_lights == "later":
                radiance, rays = self._radiance(ray, source, _LeftOut(), pdf=mi.Float(-1.0))
            elif method.seen_lights == "split":
                radiance, rays = self._radiance(ray, source, DirectWeights(), active=~self._sees_light(ray))
            else:
                radiance, rays = self._radiance(ray, source, DirectWeights())
            radiance, bad = keep_finite(method.packet.rgb(radiance * importance))
        return Traced([Contribution(place, radiance)], rays, dr.select(bad, mi.UInt32(1), 0))

    def reads(self) -> Sequence[object]:
        """See :class:`Target`."""
        return self._method.tables()

    def had_room(self, wanted: int, lanes: int) -> bool:
        """See :class:`Target`."""
        return True

    def painted(self, source: SampleSource) -> tuple[mi.Point2f, mi.Color3f, mi.UInt32]:
        """(place, light that the chains leave out times the area of the film, rays)."""
        place = self.place(source)
        with wavelengths_of(self._method, source):
            ray, importance = self._primary(place, source)
            if self._method.seen_lights == "split":
                radiance, rays = self._radiance(ray, source, DirectWeights(), active=self._sees_light(ray))
            else:
                radiance, rays = self._seen(ray)
            return place, self._method.packet.rgb(radiance * importance), rays

    def _primary(self, place: mi.Point2f, source: SampleSource) -> tuple[mi.Ray3f, mi.Spectrum]:
        """(camera ray, factor on its radiance, with the area of the film)."""
        ray, importance, _ = self._method.camera.through(place, source)
        return ray, importance * dr.opaque(mi.Float, (1.0 + 2.0 * self._method.margin) ** 2)

    def _radiance(
        self, ray: mi.Ray3f, source: SampleSource, weights: DirectWeights, active: mi.Bool | bool = True, **own: Any
    ) -> tuple[mi.Spectrum, mi.UInt32]:
        """(radiance of a path, rays). ``own``: other initial values."""
        walker = self._method.walker(Walker, proposal=self._method.settings.proposal)
        own |= {"active": (walker.max_edges > 0) & active, "hidden": walker.visibility.hidden}
        path = traced(ray, walker, weights, source, **own)
        return path.radiance, path.rays

    def _seen(self, ray: mi.Ray3f) -> tuple[mi.Spectrum, mi.UInt32]:
        """(light that is seen directly, through null surfaces as well, rays)."""
        walker = self._method.walker(Walker)

        def cross(s: CameraPath) -> CameraPath:
            vertex = walker.arrive(s)
            hit = walker.emission(s, vertex)
            s.radiance[hit.active] += s.throughput * hit.radiance
            s.active &= vertex.valid & walker.goes_on(s, vertex)
            s.active &= mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Null)
            s.throughput = s.throughput * vertex.bsdf.call(mi.BSDF.eval_null_transmission, vertex.si, active=s.active)
            s.active &= dr.max(s.throughput) > 0.0
            s.ray, s.travelled, s.depth = vertex.ray(vertex.incoming), vertex.distance, s.depth + 1
            return s

        path = CameraPath.start(ray, walker.max_edges, hidden=walker.visibility.hidden)
        path = walker.walk(path, cross, "lights that are seen")
        return path.radiance, path.rays

    def _sees_light(self, ray: mi.Ray3f) -> mi.Bool:
        """Whether the first surface on a ray emits towards it, or the environment is seen."""
        scene = self._method.scene
        si = scene.ray_intersect(ray)
        emitter = si.emitter(scene)
        shines = dr.reinterpret_array(mi.UInt32, emitter) != 0
        return dr.any(self._method.lights.of(emitter, shines).radiance(si, shines) > 0.0)


class LightFilmTarget(FilmTarget):
    """Light paths as of ``light``, each vertex of which is connected to the camera."""

    def __init__(self, method: FilmMetropolis) -> None:
        super().__init__(method)
        end, inner = light_slots(method)
        self.layouts = {"light": Layout(end, [*inner, ROULETTE], method.settings.vertices)}
        if method.seen_lights == "chain":
            self.layouts["camera"] = Layout(camera_slots(method)[0], [], 0)

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """See :class:`Target`."""
        with wavelengths_of(self._method, sources["light"]):
            return self._trace(sources, lanes)

    def _trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        method, source, camera = self._method, sources["light"], self._method.camera
        u = source.next_1d(0, dim.SPLAT_SHADOW)  # not in the layout
        splats = SplatList(camera=camera, count=method.settings.vertices, u=u)
        techniques = Techniques(emission=0, next_event=0, connection=0, merge=False)
        mis, dark = Mis(techniques, [0.0], dr.opaque(mi.Float, float(camera.pixels))), dr.opaque(mi.Float, 0.0)
        walk: LightWalk = method.walker(LightWalk, camera=camera, mis=mis, dark=dark, sink=splats)
        rays, nonfinite = walk.trace(lanes, source)
        dr.eval(rays, nonfinite, splats.array)
        contributions = splats.contributions()
        if "camera" in sources:
            place = self.place(sources["camera"])
            ray, importance = self._primary(place, sources["camera"])
            seen, seen_rays = self._seen(ray)
            seen, bad = keep_finite(method.packet.rgb(seen * importance))
            contributions.append(Contribution(place, seen))
            rays, nonfinite = rays + seen_rays, nonfinite + dr.select(bad, mi.UInt32(1), 0)
        return Traced(contributions, rays, nonfinite)


class PairFilmTarget(FilmTarget):
    """Pairs of a light path and a camera path as of :class:`PairTarget`."""

    def __init__(self, method: FilmMetropolis) -> None:
        super().__init__(method)
        self._pairs = PairTarget(method, method.settings.vertices, seen=method.seen_lights == "chain")
        self.layouts = self._pairs.layouts

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """See :class:`Target`."""
        return self._pairs.trace(sources, lanes)

    def had_room(self, wanted: int, lanes: int) -> bool:
        """See :class:`Target`."""
        return self._pairs.had_room(wanted, lanes)


#: By the setting ``paths``.
FILM_TARGETS: Mapping[str, type[FilmTarget]] = {
    "camera": FilmTarget,
    "light": LightFilmTarget,
    "bidirectional": PairFilmTarget,
}
