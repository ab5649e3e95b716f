"""Shadow rays through null surfaces.

A null surface has a BSDF with a null component (``mask``, ``null``, ``thindielectric``), through which light passes
without a change of direction. A path that crosses a null surface has no vertex there: its edge continues on the other
side. Walks, next event, connections and splats share this definition of a path. As in Mitsuba's ``path``, each crossing
counts as an edge of ``max_depth``; as in its ``volpath``, that of a surface which bounds a medium does not. The
probability of crossing is left out of all densities, as that of Russian roulette is, so that the MIS weights of a path
do not depend on the technique that samples it. Media along the ray multiply the transmittance; a null surface may
change the medium.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.scene import (
    DISPERSES,
    METER_OFFSET,
    Material,
    Media,
    Packet,
    bsdfs,
    graph,
    least_offset,
    materials,
    measured_on,
    media_in,
    medium_at,
    medium_behind,
)

from .flight import FAR, passed_by_walks
from .tracking import keys_of_ray, track


@dataclass
class Sight:
    """What is seen along a shadow ray, one lane each."""

    visible: mi.Bool  #: the end of the ray
    transmittance: mi.Spectrum | float = 1.0  #: of null surfaces and media; the number 1.0 in scenes without these
    #: Probability, by channel, that a walk passes through the media; None if none of the scene scatters.
    passing: mi.Spectrum | mi.Float | None = None


class Visibility:
    """Visibility in one scene, with its geometry at the time of construction. ``transparent``: whether the scene has
    null surfaces; ``specular``: whether it has these, mirrors or smooth glass; ``sensor``: where camera paths start;
    ``hides_lights``: whether the camera sees no lights, but what is behind them."""

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        packet: Packet | None = None,
        hides_lights: bool = False,
    ) -> None:
        self.scene, self.hides_lights = scene, hides_lights
        #: The wavelengths of light vertices.
        self.packet = packet or Packet()
        #: The participating media; None if there are none.
        self.media = media_in(scene, sensor)
        self.bsdfs = bsdfs(scene, sensor) if self.media is None else self.media.bsdfs
        #: The material of meters, on which camera paths begin; None: they begin at a camera.
        self.measured_on = measured_on(sensor)
        self._least_offset = 0.0 if self.measured_on is None else least_offset(scene)
        found = [node for node in materials(scene) if isinstance(node, mi.BSDF)]
        self.transparent = any(map(_passes, found))
        #: Whether refraction depends on the wavelength.
        self.disperses = any(bsdf.flags() & DISPERSES for bsdf in found)
        #: Whether textures are averaged over the footprint of a pixel.
        self.mipmaps = any(graph.plugin_name(node) == "mipmap" for node in materials(scene))
        self.specular = any(mi.has_flag(node.flags(), mi.BSDFFlags.Delta) for node in found)
        #: The opaque meshes alone, which block nearly all blocked shadow rays: an any-hit test costs less than what is
        #: found out along a ray. Not on a GPU, where a kernel traces rays in one scene only.
        self._opaque = None
        if self.transparent and dr.backend_v(mi.Float) == dr.JitBackend.LLVM and _has_masks(scene):
            self._opaque = _opaque_meshes(scene)

    @property
    def volumes(self) -> bool:
        """Whether a medium scatters light, so that vertices may be in media."""
        return self.media is not None and self.media.scatters

    @property
    def hidden(self) -> mi.Bool | None:
        """Initial :attr:`SubPath.hidden` of camera paths; a new one each time, because a walk changes that of its
        paths."""
        return mi.Bool(True) if self.hides_lights else None

    def material(self, si: mi.SurfaceInteraction3f, ray: mi.Ray3f) -> Material:
        """The material at the end of a ray."""
        return Material(si.bsdf(ray), self.bsdfs)

    def begin_on_meter(
        self, si: mi.SurfaceInteraction3f, material: Material, ray: mi.Ray3f, first: mi.Bool
    ) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
        """The end of the edges that are the ``first`` of a camera path, if there are meters: it is the origin of the
        ray, on a surface that the ray meets at a right angle. And the share of Mitsuba's offset with which rays leave:
        a meter is not rounded as the end of a ray is, and at the edge of a shadow a tenth of a millimetre tells."""
        there = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray.o))
        there.t, there.time, there.wavelengths = 1.0, ray.time, ray.wavelengths
        there.p, there.n = ray.o, mi.Normal3f(-ray.d)
        there.sh_frame = mi.Frame3f(-ray.d)
        there.wi = mi.Vector3f(0.0, 0.0, 1.0)
        material.pointer = dr.select(first, mi.BSDFPtr(self.measured_on), material.pointer)
        share = mi.Float(METER_OFFSET)
        if self._least_offset > 0.0:
            ones = mi.math.RayEpsilon * (1.0 + dr.max(dr.abs(ray.o)))
            share = dr.maximum(share, dr.opaque(mi.Float, self._least_offset) / ones)
        return dr.select(first, there, si), dr.select(first, share, 1.0)

    def medium_outside(self, light: mi.UInt32, ray: mi.Ray3f) -> mi.UInt32 | None:
        """The medium in which rays start that leave a light; None in scenes without media."""
        if self.media is None:
            return None
        medium = self.media.outside(light)
        if not self.media.divides_lamps:
            return medium
        unknown = self.media.is_unknown(medium)
        return dr.select(unknown, medium_at(self.scene, ray, unknown), medium)

    def along(
        self,
        ray: mi.Ray3f,
        crossings: mi.UInt32,
        active: mi.Bool,
        medium: mi.UInt32 | None = None,
        hidden: mi.Bool | None = None,
    ) -> Sight:
        """What is seen along a shadow ray that starts in ``medium``. ``crossings``: the largest number of null surfaces
        on the ray that do not bound a medium; ``hidden``: lanes whose ray passes lamps."""
        if not self.transparent and hidden is None:
            visible = active & ~self.scene.ray_test(ray, active)
            if self.media is None or medium is None:
                return Sight(visible)
            return Sight(visible, *self._through(self.media, medium, ray, ray.maxt, visible))
        transmittance = mi.Spectrum(1.0)
        if self._opaque is not None and hidden is None:
            blocked = self._opaque.ray_test(ray, active)
            active, transmittance = active & ~blocked, transmittance & ~blocked

        time, wavelengths = ray.time, ray.wavelengths  # outside the loop state: see ``loop_traced_once``

        def cross(
            active: mi.Bool,
            o: mi.Point3f,
            d: mi.Vector3f,
            maxt: mi.Float,
            transmittance: mi.Spectrum,
            crossings: mi.UInt32,
            medium: mi.UInt32 | None,
            passing: mi.Spectrum | mi.Float | None,
        ) -> tuple[Any, ...]:
            ray = mi.Ray3f(o, d, maxt, time, wavelengths)
            hit = self.scene.ray_intersect_preliminary(ray, active=active)
            if self.media is not None and medium is not None:
                through, passes = self._through(self.media, medium, ray, dr.minimum(hit.t, ray.maxt), active)
                transmittance = dr.select(active, transmittance * through, transmittance)
                if passing is not None:
                    passing = dr.select(active, passing * passes, passing)
            active = active & hit.is_valid()
            # The preliminary intersection of an instance does not give the BSDF of the shape that was hit.
            instanced = dr.reinterpret_array(mi.UInt32, hit.instance) != 0
            null = instanced | mi.has_flag(hit.shape.bsdf().flags(), mi.BSDFFlags.Null)
            null &= active
            if medium is None:
                null &= crossings > 0
            lamp = mi.Bool(False) if hidden is None else active & hidden & is_lamp(hit.shape)
            null |= lamp
            transmittance = dr.select(active & ~null, 0.0, transmittance)

            def behind(
                null: mi.Bool,
                ray: mi.Ray3f,
                transmittance: mi.Spectrum,
                crossings: mi.UInt32,
                medium: mi.UInt32 | None,
                hit: mi.PreliminaryIntersection3f,
                lamp: mi.Bool,
            ) -> tuple[mi.Bool, mi.Ray3f, mi.Spectrum, mi.UInt32, mi.UInt32 | None]:
                si = hit.compute_surface_interaction(ray, active=null)
                material = self.material(si, ray)
                passed = material.call(mi.BSDF.eval_null_transmission, si, active=null & ~lamp)
                transmittance = transmittance * dr.select(lamp, 1.0, passed)
                # The direction to the end point is computed again: the new origin is offset from the surface, and a ray
                # in the old direction could hit the light at the end.
                finite = ray.maxt < dr.largest(mi.Float)
                end = ray(dr.select(finite, ray.maxt, si.t))
                onward = dr.select(finite, si.spawn_ray_to(end), si.spawn_ray(ray.d))
                if medium is not None:
                    bounds = si.is_medium_transition() & ~lamp
                    medium = dr.select(lamp, medium, medium_behind(si, ray.d, medium))
                    transmittance = dr.select(bounds | lamp | (crossings > 0), transmittance, 0.0)
                    crossings = dr.select(bounds | lamp, crossings, crossings - 1)
                null = null & (dr.max(transmittance) > 0.0) & (onward.maxt > 0.0)
                return null, dr.select(null, onward, ray), transmittance, crossings, medium

            # A branch, because most occluders are opaque and computing the surface interaction is expensive.
            arguments = null, ray, transmittance, crossings, medium, hit, lamp
            crosses, ray, transmittance, crossings, medium = dr.if_stmt(
                arguments, null, behind, lambda *untouched: untouched[:5], label="crossing"
            )
            if medium is None:
                crossings = dr.select(lamp, crossings, crossings - 1)
            return crosses, ray.o, ray.d, ray.maxt, transmittance, crossings, medium, passing

        first = mi.Point3f(ray.o), mi.Vector3f(ray.d), mi.Float(ray.maxt)
        scatters = self.volumes and medium is not None
        rest = medium, self.media.one() if scatters and self.media else None
        start = mi.Bool(active), *first, transmittance, mi.UInt32(crossings), *rest
        *_, transmittance, _, _, passing = dr.while_loop(start, lambda active, *_: active, cross, label="transmittance")
        return Sight(active & (dr.max(transmittance) > 0.0), transmittance, passing)

    @staticmethod
    def _through(
        media: Media, medium: mi.UInt32, ray: mi.Ray3f, distance: mi.Float, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Spectrum | mi.Float | None]:
        """(transmittance, :attr:`Sight.passing`) of a distance along a ray in a medium."""
        tracked = track(media, medium, ray, distance, keys_of_ray(ray), active) if media.heterogeneous else None
        distance = dr.minimum(distance, FAR)
        transmittance = dr.exp(-media.extinction(medium) * distance)
        if tracked is not None:
            transmittance *= tracked.passed
        passing = passed_by_walks(media, medium, distance, tracked) if media.scatters else None
        return transmittance, passing


def past_lamps(
    scene: mi.Scene, hit: mi.PreliminaryIntersection3f, ray: mi.Ray3f, hidden: mi.Bool | bool = True
) -> mi.PreliminaryIntersection3f:
    """What a ray meets behind lamps, if its end ``hit`` is on one and lamps are ``hidden`` from it."""

    def onwards(passes: mi.Bool, hit: mi.PreliminaryIntersection3f) -> tuple[mi.Bool, mi.PreliminaryIntersection3f]:
        start = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, passes).spawn_ray(ray.d)
        start.maxt, moved = ray.maxt - hit.t, dr.dot(start.o - ray.o, ray.d)
        behind = scene.ray_intersect_preliminary(start, active=passes)
        behind.t += moved
        hit = dr.select(passes, behind, hit)
        return passes & hit.is_valid() & is_lamp(hit.shape), hit

    passes = hidden & hit.is_valid() & is_lamp(hit.shape)
    return dr.while_loop((passes, hit), lambda passes, _: passes, onwards, label="past lamps")[1]


def is_lamp(shape: mi.ShapePtr) -> mi.Bool:
    """Lanes whose shape emits light."""
    return dr.reinterpret_array(mi.UInt32, shape.emitter()) != 0


def _passes(bsdf: mi.BSDF) -> bool:
    """Whether a material has a null component."""
    return bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null))


def _has_masks(scene: mi.Scene) -> bool:
    """Whether a null surface bounds no medium. Those that do are few: most rays meet none before their end."""
    return any(_passes(shape.bsdf()) and not shape.is_medium_transition() for shape in graph.shapes(scene))


def _opaque_meshes(scene: mi.Scene) -> mi.Scene | None:
    """A scene of the triangles of all meshes without a null component; ``None`` if there are none.

    The triangles are copied into one mesh, because a mesh keeps a pointer to the last scene that it was added to."""
    meshes = [shape for shape in scene.shapes() if shape.is_mesh() and not _passes(shape.bsdf())]
    if not meshes:
        return None
    points = [np.asarray(mesh.vertex_positions_buffer()) for mesh in meshes]
    first = np.cumsum([0, *(len(p) // 3 for p in points)])
    faces = [np.asarray(mesh.faces_buffer()) + np.uint32(n) for mesh, n in zip(meshes, first, strict=False)]
    properties = mi.Properties()
    properties["mesh_bsdf"] = meshes[0].bsdf()  # a further BSDF would be compiled into every kernel
    joined = mi.Mesh("opaque", int(first[-1]), sum(len(f) for f in faces) // 3, props=properties)
    parameters = mi.traverse(joined)
    parameters["vertex_positions"] = np.concatenate(points)
    parameters["faces"] = np.concatenate(faces)
    parameters.update()
    return mi.load_dict({"type": "scene", "opaque": joined})
