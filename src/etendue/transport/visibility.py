"""Shadow rays, and what lets them pass: materials with a null component do not block, they attenuate.

A surface that light may cross unbent (``mask``, ``null``, ``thindielectric``) is no vertex of a path where the path
crosses it: the edge goes on behind it. Walks, next event, connections and splats all treat it so, and therefore agree
on what a path is. Each crossing counts as an edge of ``max_depth``, as in Mitsuba. The probability of crossing is left
out of every density, like Russian roulette: weights stay the same whichever technique makes the path.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.scene import materials


class Visibility:
    """Joins points of one scene. ``transparent``: some material lets light through unbent, so walks must know."""

    def __init__(self, scene: Any) -> None:
        self.scene = scene
        self.transparent = any(
            mi.has_flag(node.flags(), mi.BSDFFlags.Null) for node in materials(scene) if isinstance(node, mi.BSDF)
        )

    def along(self, ray: Any, spare: Any, active: Any) -> tuple[Any, Any]:
        """Whether the end of ``ray`` is seen, and the share of light that gets through (1.0 where nothing is
        transparent); ``spare``: how many surfaces may be crossed."""
        if not self.transparent:
            return active & ~self.scene.ray_test(ray, active), 1.0

        def cross(active: Any, ray: Any, share: Any, spare: Any) -> tuple[Any, Any, Any, Any]:
            hit = self.scene.ray_intersect_preliminary(ray, active=active)
            active = active & hit.is_valid()
            # Of an instance it is not known before a closer look which of its shapes was hit.
            instanced = dr.reinterpret_array(mi.UInt32, hit.instance) != 0
            thin = instanced | mi.has_flag(hit.shape.bsdf().flags(), mi.BSDFFlags.Null)
            thin &= active & (spare > 0)
            share = dr.select(active & ~thin, 0.0, share)

            def behind(thin: Any, ray: Any, share: Any, hit: Any) -> tuple[Any, Any, Any]:
                si = hit.compute_surface_interaction(ray, active=thin)
                share = share * si.bsdf(ray).eval_null_transmission(si, thin)
                # Aimed anew: a ray starts beside the surface, and would strike a light at its end from the side.
                ends = ray.maxt < dr.largest(mi.Float)  # that, or infinity, is how far an endless ray reaches
                onward = dr.select(ends, si.spawn_ray_to(ray(dr.select(ends, ray.maxt, si.t))), si.spawn_ray(ray.d))
                thin = thin & (dr.max(share) > 0.0) & (onward.maxt > 0.0)
                return thin, dr.select(thin, onward, ray), share

            # A branch: what lies in the way is opaque as a rule, and looking closely at a surface is dear.
            arguments = thin, ray, share, hit
            passes, ray, share = dr.if_stmt(arguments, thin, behind, lambda *untouched: untouched[:3], label="crossing")
            return passes, ray, share, spare - 1

        start = mi.Bool(active), mi.Ray3f(ray), mi.Color3f(1.0), mi.UInt32(spare)
        _, _, share, _ = dr.while_loop(start, lambda active, *_: active, cross, label="transmittance")
        return active & (dr.max(share) > 0.0), share
