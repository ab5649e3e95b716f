"""Meters in a scene, as the pixels of a picture: methods that render pictures measure light through them.

Irradiance E is pi times the radiance of a white surface, so that a meter is a vertex like any other: lamps are sampled
from there, and light paths connected to it. Nothing in the scene meets this surface.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SceneError, UnsupportedError, as_array, copied_to_device, uses_cuda

from .graph import describe, plugin_name
from .immersion import medium_at
from .media import media_of
from .problem import Problem
from .space import half_diagonal, largest_offset

if TYPE_CHECKING:
    from etendue.lighting import Meters

#: Directions around a meter in which backs of surfaces are looked for, and most meters that a message names.
_AROUND, _NAMED = 64, 3
#: Share of Mitsuba's ray offset by which rays start off meters of irradiance: 47 steps of single precision.
METER_OFFSET = 1.0 / 32.0
#: Least distance of the start of a ray off a triangle that OptiX is not to find, as a share of half the diagonal of its
#: box, in steps of single precision; seen on an H200: 0.5.
_OPTIX_STEPS = 1.0


def with_own_meter(problem: Problem) -> Problem:
    """The same problem; Mitsuba's ``radiancemeter`` and ``irradiancemeter`` are replaced by meters, which sample lamps
    as a surface does. Raises :class:`UnsupportedError` for a ``distant`` sensor of a scene that is rendered in other
    coordinates."""
    sensor = problem.sensor
    kind = plugin_name(sensor)
    if kind == "distant" and not problem.space.is_own:
        raise UnsupportedError(
            f"{describe(sensor, 'sensor')} looks at a scene that is far from the origin or small, which is not "
            "supported; move the scene near the origin and scale it to a size of 1 to 100"
        )
    if kind == "radiancemeter":
        from etendue.lighting import Meters

        to_world = as_array(sensor.world_transform()).astype(np.float64).reshape(4, 4)
        return with_meters(problem, Meters(to_world[None, :3, 3], to_world[None, :3, 2], "radiance"))
    if kind == "irradiancemeter":
        width, height = problem.size
        film = _film(width, height)
        own = mi.load_dict({"type": "meters", "irradiance": True, "sampler": sensor.sampler(), "film": film})
        own.shape = sensor.get_shape()
        return replace(problem, sensor=own)
    return problem


def with_meters(problem: Problem, meters: Meters) -> Problem:
    """The scene of a problem, seen by meters, one pixel each.

    Raises :class:`SceneError` for meters inside closed solids or in a medium.
    """
    points = problem.space.from_scene(meters.points)
    measures_irradiance = meters.quantity != "radiance"
    _check_places(problem.scene, points, meters)
    if measures_irradiance:
        points = _on_surfaces(problem.scene, points, meters.directions)
    # Mitsuba's properties try to read a tensor with three rows as a colour, and say that they cannot.
    origins, directions = (
        mi.TensorXf(np.ascontiguousarray(v[None], np.float32))
        for v in (points, -meters.directions if measures_irradiance else meters.directions)
    )
    plugin: dict[str, Any] = {"type": "meters", "origins": origins, "directions": directions}
    plugin["irradiance"] = measures_irradiance
    if meters.quantity in ("cylindrical", "spherical"):
        plugin["turned"] = meters.quantity
    sensor = mi.load_dict(plugin | {"film": _film(len(meters), 1)})
    return replace(problem, sensor=sensor, size=(len(meters), 1))


def least_offset(scene: mi.Scene) -> float:
    """The least distance off a surface from which rays leave the largest triangles that a scene may have; 0 on a CPU,
    where Embree's rays leave from any."""
    return _OPTIX_STEPS * float(np.finfo(np.float32).eps) * half_diagonal(scene) if uses_cuda() else 0.0


def _film(width: int, height: int) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": width, "height": height, "filter": {"type": "box"}}


def _on_surfaces(scene: mi.Scene, points: Array, normals: Array) -> Array:
    """The points, moved along their normals onto surfaces that are nearer than Mitsuba's ray offset: these are meant,
    and rays from meters start closer to them (:data:`METER_OFFSET`)."""
    reach = mi.math.RayEpsilon * (1.0 + np.abs(points).max(axis=1))
    above = points + reach[:, None] * normals
    o, d = (mi.Vector3f(*(copied_to_device(mi.Float, np.float32(x)) for x in v.T)) for v in (above, -normals))
    hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o), d))
    distance = np.array(hit.t, np.float64)
    near = distance <= 2.0 * reach
    return points + np.where(near, reach - distance, 0.0)[:, None] * normals


def _check_places(scene: mi.Scene, points: Array, meters: Meters) -> None:
    """Raise :class:`SceneError` for meters in a medium, and for those from which rays in all directions meet backs of
    surfaces that reflect and transmit nothing."""
    number = np.arange(_AROUND)
    z, phi = 1.0 - (2.0 * number + 1.0) / _AROUND, number * np.pi * (3.0 - np.sqrt(5.0))
    around = np.stack([np.sqrt(1.0 - z * z) * np.cos(phi), np.sqrt(1.0 - z * z) * np.sin(phi), z], axis=1)
    above = points + 2.0 * largest_offset(scene) * meters.directions  # a point may be on a surface
    starts, ways = np.repeat(above, _AROUND, axis=0), np.tile(around, (len(points), 1))
    o, d = (
        mi.Vector3f(*(copied_to_device(mi.Float, np.ascontiguousarray(x, np.float32)) for x in v.T))
        for v in (starts, ways)
    )
    ray = mi.Ray3f(mi.Point3f(o), d)
    si = scene.ray_intersect(ray)
    through = +mi.BSDFFlags.BackSide | +mi.BSDFFlags.Transmission | +mi.BSDFFlags.Null
    dark = si.is_valid() & (dr.dot(si.n, ray.d) > 0.0) & ((si.bsdf().flags() & through) == 0)
    inside = np.asarray(np.array(dark).reshape(-1, _AROUND).all(axis=1))
    _refuse(meters, inside, "inside a solid: all around is the back of a surface")
    if media_of(scene):
        medium = medium_at(scene, ray, mi.Bool(True) & (dr.width(ray.d) > 0))
        held = (np.array(medium).reshape(-1, _AROUND) != 0).mean(axis=1) > 0.5
        _refuse(meters, held, "in a medium, where no light is measured")


def _refuse(meters: Meters, wrong: NDArray[Any], why: str) -> None:
    found = np.flatnonzero(wrong)
    if not len(found):
        return
    which = ", ".join(f"{k} at {np.round(meters.points[k], 4).tolist()}" for k in found[:_NAMED])
    rest = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    raise SceneError(f"meter {which}{rest}: {why}; move it")
