"""Shadow rays through null surfaces.

A null surface has a BSDF with a null component (``mask``, ``null``, ``thindielectric``), through which light passes
without a change of direction. A path that crosses a null surface has no vertex there: its edge continues on the other
side. Walks, next event, connections and splats share this definition of a path. As in Mitsuba, each crossing counts as
an edge of ``max_depth``. The probability of crossing is left out of all densities, as that of Russian roulette is, so
that the MIS weights of a path do not depend on the technique that samples it.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.scene import Material, bsdfs, graph, materials


class Visibility:
    """Visibility in one scene, with its geometry at the time of construction. ``transparent``: whether the scene has
    null surfaces; ``specular``: whether it has these, mirrors or smooth glass."""

    def __init__(self, scene: mi.Scene) -> None:
        self.scene = scene
        self.bsdfs = bsdfs(scene)
        found = [node for node in materials(scene) if isinstance(node, mi.BSDF)]
        self.transparent = any(map(_passes, found))
        #: Whether textures are averaged over the footprint of a pixel.
        self.mipmaps = any(graph.plugin_name(node) == "mipmap" for node in materials(scene))
        self.specular = any(mi.has_flag(node.flags(), mi.BSDFFlags.Delta) for node in found)
        #: The opaque meshes alone, which block nearly all blocked shadow rays: an any-hit test costs less than the
        #: closest intersection. Not on a GPU, where a kernel traces rays in one scene only.
        self._opaque = (
            _opaque_meshes(scene) if self.transparent and dr.backend_v(mi.Float) == dr.JitBackend.LLVM else None
        )

    def material(self, si: mi.SurfaceInteraction3f, ray: mi.Ray3f) -> Material:
        """The material at the end of a ray."""
        return Material(si.bsdf(ray), self.bsdfs)

    def along(self, ray: mi.Ray3f, crossings: mi.UInt32, active: mi.Bool) -> tuple[mi.Bool, mi.Color3f | float]:
        """(whether the end of a shadow ray is visible, transmittance along the ray); the transmittance is the number
        1.0 in scenes without null surfaces. ``crossings``: the largest number of null surfaces on the ray."""
        if not self.transparent:
            return active & ~self.scene.ray_test(ray, active), 1.0
        transmittance = mi.Color3f(1.0)
        if self._opaque is not None:
            blocked = self._opaque.ray_test(ray, active)
            active, transmittance = active & ~blocked, transmittance & ~blocked

        time, wavelengths = ray.time, ray.wavelengths  # outside the loop state: see ``loop_traced_once``

        def cross(
            active: mi.Bool,
            o: mi.Point3f,
            d: mi.Vector3f,
            maxt: mi.Float,
            transmittance: mi.Color3f,
            crossings: mi.UInt32,
        ) -> tuple[mi.Bool, mi.Point3f, mi.Vector3f, mi.Float, mi.Color3f, mi.UInt32]:
            ray = mi.Ray3f(o, d, maxt, time, wavelengths)
            hit = self.scene.ray_intersect_preliminary(ray, active=active)
            active = active & hit.is_valid()
            # The preliminary intersection of an instance does not give the BSDF of the shape that was hit.
            instanced = dr.reinterpret_array(mi.UInt32, hit.instance) != 0
            null = instanced | mi.has_flag(hit.shape.bsdf().flags(), mi.BSDFFlags.Null)
            null &= active & (crossings > 0)
            transmittance = dr.select(active & ~null, 0.0, transmittance)

            def behind(
                null: mi.Bool, ray: mi.Ray3f, transmittance: mi.Color3f, hit: mi.PreliminaryIntersection3f
            ) -> tuple[mi.Bool, mi.Ray3f, mi.Color3f]:
                si = hit.compute_surface_interaction(ray, active=null)
                material = self.material(si, ray)
                transmittance = transmittance * material.call(mi.BSDF.eval_null_transmission, si, active=null)
                # The direction to the end point is computed again: the new origin is offset from the surface, and a ray
                # in the old direction could hit the light at the end.
                finite = ray.maxt < dr.largest(mi.Float)
                end = ray(dr.select(finite, ray.maxt, si.t))
                onward = dr.select(finite, si.spawn_ray_to(end), si.spawn_ray(ray.d))
                null = null & (dr.max(transmittance) > 0.0) & (onward.maxt > 0.0)
                return null, dr.select(null, onward, ray), transmittance

            # A branch, because most occluders are opaque and computing the surface interaction is expensive.
            arguments = null, ray, transmittance, hit
            crosses, ray, transmittance = dr.if_stmt(
                arguments, null, behind, lambda *untouched: untouched[:3], label="crossing"
            )
            return crosses, ray.o, ray.d, ray.maxt, transmittance, crossings - 1

        first = mi.Point3f(ray.o), mi.Vector3f(ray.d), mi.Float(ray.maxt)
        start = mi.Bool(active), *first, transmittance, mi.UInt32(crossings)
        *_, transmittance, _ = dr.while_loop(start, lambda active, *_: active, cross, label="transmittance")
        return active & (dr.max(transmittance) > 0.0), transmittance


def _passes(bsdf: mi.BSDF) -> bool:
    """Whether a material has a null component."""
    return bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null))


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
