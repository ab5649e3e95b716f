"""In which medium lamps are, and whether the media of a scene fit together, by rays that cross the scene.

Rays go straight on through surfaces that transmit light or bound a medium, and end at others.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, SceneError, copied_to_device

from .bounds import corners_of
from .graph import describe, shapes
from .media import UNKNOWN, Media, media_of, medium_behind, number_of, scatters
from .space import warn_once

#: Rays from each lamp, and from the sensor; and most surfaces on a ray.
_FROM_LAMP, _FROM_SENSOR, _MOST = 64, 1 << 11, 64
#: Rays that find a fault by rounding: through the edge between two triangles.
_BY_CHANCE = 2


@dataclass
class _Crossing:
    """State of rays, one lane each."""

    active: mi.Bool
    o: mi.Point3f
    d: mi.Vector3f
    medium: mi.UInt32  #: UNKNOWN: not known before the first boundary
    first: mi.UInt32  #: the medium that the ray started in by its first boundary; UNKNOWN: it met none
    wrong: mi.UInt32  #: pointer to the first boundary whose near side is another medium; 0: none
    near: mi.UInt32  #: medium of its near side
    held: mi.UInt32  #: the medium that the ray was in there, or in which it left the scene
    left: mi.Bool  #: it has left the scene
    count: mi.UInt32


def _scatters(si: mi.SurfaceInteraction3f) -> mi.Bool:
    """Whether light goes on at a surface, on the side of ``si.wi`` or behind it."""
    lit = (mi.Frame3f.cos_theta(si.wi) > 0.0) | mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.BackSide)
    return lit | _is_clear(si)


def _is_clear(si: mi.SurfaceInteraction3f) -> mi.Bool:
    flags = si.bsdf().flags()
    return mi.has_flag(flags, mi.BSDFFlags.Null) | mi.has_flag(flags, mi.BSDFFlags.Transmission)


def _crossed(scene: mi.Scene, ray: mi.Ray3f, medium: mi.UInt32) -> _Crossing:
    """Rays that start in ``medium``, to their ends."""
    n = dr.width(ray.o)

    def step(s: _Crossing) -> tuple[_Crossing]:
        si = scene.ray_intersect(mi.Ray3f(s.o, s.d), s.active)
        hit = s.active & si.is_valid()
        bounds = hit & si.is_medium_transition()
        near = dr.reinterpret_array(mi.UInt32, si.target_medium(-s.d))
        s.first = dr.select(bounds & (s.first == UNKNOWN), near, s.first)
        wrong = bounds & (s.medium != UNKNOWN) & (near != s.medium) & _scatters(si)
        s.wrong = dr.select(wrong, dr.reinterpret_array(mi.UInt32, si.shape), s.wrong)
        s.near, s.held = dr.select(wrong, near, s.near), dr.select(s.active, s.medium, s.held)
        s.left |= s.active & ~si.is_valid()
        s.medium = dr.select(hit, medium_behind(si, s.d, s.medium), s.medium)
        s.count += 1
        s.active = hit & ~wrong & _is_clear(si) & (s.count < _MOST)
        s.o = dr.select(hit, si.spawn_ray(s.d).o, s.o)
        return (s,)

    start = _Crossing(
        active=dr.full(mi.Bool, True, n),
        o=mi.Point3f(ray.o),
        d=mi.Vector3f(ray.d),
        medium=mi.UInt32(medium),
        first=dr.full(mi.UInt32, UNKNOWN, n),
        wrong=dr.zeros(mi.UInt32, n),
        near=dr.zeros(mi.UInt32, n),
        held=dr.zeros(mi.UInt32, n),
        left=dr.full(mi.Bool, False, n),
        count=dr.zeros(mi.UInt32, n),
    )
    (end,) = dr.while_loop((start,), lambda s: s.active, step, label="media")
    dr.eval(end)
    return end


def media_in(scene: mi.Scene, sensor: mi.Sensor | None) -> Media | None:
    """The media of a scene; None if there are none."""
    if not (found := media_of(scene, sensor)):
        return None
    return Media(scene, found, sensor, [_outside(scene, emitter) for emitter in scene.emitters()])


def _outside(scene: mi.Scene, emitter: mi.Emitter) -> int:
    """Number of the medium on the lit side of an emitter, 0 for none; UNKNOWN: not the same everywhere."""
    shape = emitter.get_shape()
    if shape is not None and mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface) and shape.is_medium_transition():
        return number_of(shape.exterior_medium())
    return number_of(emitter.get_medium()) or _around(scene, emitter)


def _around(scene: mi.Scene, emitter: mi.Emitter) -> int:
    """Number of the medium that a lamp without one of its own is in, by the boundaries that are seen from it; 0 for
    none, or if no boundary is seen; UNKNOWN if parts of it are in different media."""
    shape = emitter.get_shape()
    rng = np.random.default_rng(0)
    on_shape, towards = (_points(*rng.random((2, _FROM_LAMP))) for _ in range(2))
    if shape is not None and mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
        place = shape.sample_position(0.0, on_shape)
        d = mi.Frame3f(place.n).to_world(mi.warp.square_to_cosine_hemisphere(towards))
        si = dr.zeros(mi.SurfaceInteraction3f, _FROM_LAMP)
        si.p, si.n = place.p, place.n
        ray = si.spawn_ray(d)
    elif mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaPosition):
        origin = emitter.world_transform().translation()
        way = mi.warp.square_to_uniform_sphere(towards)
        ray = mi.Ray3f(mi.Point3f(origin) + 0.0 * way, way)
    else:
        return 0
    first = np.asarray(_crossed(scene, ray, dr.full(mi.UInt32, UNKNOWN, _FROM_LAMP)).first)
    met = np.unique(first[first != UNKNOWN])
    return UNKNOWN if len(met) > 1 else int(met[0]) if len(met) else 0


def medium_at(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.UInt32:
    """Number of the medium in which rays start, by the first boundary on them, behind any other surface; 0 for none.
    Part of a kernel."""

    def step(active: mi.Bool, o: mi.Point3f, medium: mi.UInt32) -> tuple[mi.Bool, mi.Point3f, mi.UInt32]:
        si = scene.ray_intersect(mi.Ray3f(o, ray.d), active)
        bounds = active & si.is_valid() & si.is_medium_transition()
        medium = dr.select(bounds, dr.reinterpret_array(mi.UInt32, si.target_medium(-ray.d)), medium)
        active &= si.is_valid() & ~bounds
        return active, dr.select(active, si.spawn_ray(ray.d).o, o), medium

    start = mi.Bool(active), mi.Point3f(ray.o), mi.UInt32(0)
    return dr.while_loop(start, lambda active, *_: active, step, label="medium of a lamp")[2]


def check_media(scene: mi.Scene, sensor: mi.Sensor) -> None:
    """Raise :class:`SceneError` if rays from the sensor, or from points that it looks through, find that media do not
    fit together: a boundary whose near side is another medium than that before it, or a medium that no shape closes."""
    if not media_of(scene, sensor):
        return
    u = np.random.default_rng(0).random((5, _FROM_SENSOR))
    film, rest = _points(*u[3:]), _points(*u[:2])
    ray, _ = sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
    way = mi.warp.square_to_uniform_sphere(rest)
    share = copied_to_device(mi.Float, u[2].astype(np.float32))
    medium = dr.full(mi.UInt32, number_of(sensor.get_medium()), _FROM_SENSOR)
    named = {number_of(one): describe(one, "medium") for one in media_of(scene, sensor)} | {0: "no medium"}
    _fits(scene, sensor, _crossed(scene, ray, medium), named, from_sensor=True)
    # Before the first surface, and behind it: once more from a point in between, into any direction.
    for _ in range(2):
        si = scene.ray_intersect(ray)
        length = dr.minimum(si.t, float(np.linalg.norm(np.subtract(*corners_of(scene)))))
        _fits(scene, sensor, _crossed(scene, mi.Ray3f(ray(share * length), way), medium), named)
        goes_on = si.is_valid() & _is_clear(si)
        medium = dr.select(goes_on, medium_behind(si, ray.d, medium), medium)
        ray = dr.select(goes_on, si.spawn_ray(ray.d), ray)


def _fits(
    scene: mi.Scene, sensor: mi.Sensor, found: _Crossing, named: dict[int, str], from_sensor: bool = False
) -> None:
    """Raise :class:`SceneError` for rays that found a fault. If no medium scatters, a fault away from the sensor causes
    a warning: glass that overlaps with what it contains is common. ``named``: descriptions of the media by number."""
    wrong, count, near, held = (np.asarray(a) for a in (found.wrong, found.count, found.near, found.held))
    if np.count_nonzero(wrong) > _BY_CHANCE:
        lanes = np.flatnonzero(wrong)
        lane = lanes[np.argmin(count[lanes])]
        there, here = (named.get(int(a[lane]), "another medium") for a in (near, held))
        shape = next((describe(s, "shape") for s in shapes(scene) if _pointer(s) == int(wrong[lane])), "a shape")
        if from_sensor and count[lane] == 1:
            raise SceneError(
                f"{describe(sensor, 'sensor')} is in {here}, but {shape}, which it sees first, has {there} on that "
                "side; give both the same medium"
            )
        _fault(
            scene,
            sensor,
            f"{shape} has {there} on a side that rays reach through {here}; give each boundary the media of its two "
            "sides as 'interior' and 'exterior', and let boundaries not overlap",
        )
    escaped = np.asarray(found.left) & (held != 0)
    if np.count_nonzero(escaped) > _BY_CHANCE:
        medium = named.get(int(held[np.argmax(escaped)]), "a medium")
        _fault(
            scene,
            sensor,
            f"{medium} is not closed: rays leave the scene in it; enclose it in a shape with the material 'null' and "
            "the medium as its interior",
        )


def _fault(scene: mi.Scene, sensor: mi.Sensor, message: str) -> None:
    if any(map(scatters, media_of(scene, sensor))):
        raise SceneError(message)
    warn_once(message)


def _points(x: Array, y: Array) -> mi.Point2f:
    return mi.Point2f(*(copied_to_device(mi.Float, axis.astype(np.float32)) for axis in (x, y)))


def _pointer(shape: mi.Shape) -> int:
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])
