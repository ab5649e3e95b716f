"""The light end of a path: rays that leave lights, light points for next event, and the densities of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import Light, LightTable, graph, sphere_point, surface_point, uniform_point, varies

from . import dimensions as dim
from .guiding.lights import LocalLights
from .spheres import cone_of, point_in, seen_density


@dataclass
class EmittedRay:
    """A ray sampled from the lights, one lane each."""

    ray: Any
    light: Any  #: its number
    throughput: Any  #: emitted radiance times cos over the density: the flux the path carries
    #: Of the light point under next event, picking included (infinite: of the direction). Of a spherical light it is
    #: that of emission: next event's depends on the point that is lit (see :mod:`.spheres`).
    area_density: Any
    emission_density: Any  #: of point and direction together, picking included
    cos_light: Any  #: 1 where the light has no surface
    is_delta: Any
    is_infinite: Any
    active: Any


@dataclass
class DirectSample:
    """A light point joined to a surface point, one lane each."""

    direction: Any  #: world, towards the light
    target: Any  #: end point of the shadow ray
    light: Any  #: its number
    radiance: Any  #: what arrives, over ``pdf``
    pdf: Any  #: solid-angle density of the direction, picking included
    light_ratio: Any  #: emission density over (pdf times cos at the light); times cos at the surface for the weight
    is_delta: Any
    active: Any


def emit(lights: LightTable, source: SampleSource, active: Any) -> EmittedRay:
    """Sample a ray that leaves a light: emitter by power, then point and direction by its kind."""
    light = lights.pick(source.next_1d(0, dim.LIGHT_PICK), active)
    u_point = mi.Point2f(*source.next_2d(0, dim.LIGHT_POINT))
    u_direction = mi.Point2f(*source.next_2d(0, dim.LIGHT_DIRECTION))
    n = dr.width(u_point)
    result = EmittedRay(
        ray=dr.zeros(mi.Ray3f, n),
        light=light.row,
        throughput=dr.zeros(mi.Color3f, n),
        area_density=dr.full(mi.Float, 1.0, n),
        emission_density=dr.full(mi.Float, 1.0, n),
        cos_light=dr.full(mi.Float, 1.0, n),
        is_delta=mi.Bool(light.is_delta),
        is_infinite=mi.Bool(light.is_infinite),
        active=mi.Bool(active),
    )
    if lights.has_area:
        _emit_area(result, lights, light, u_point, u_direction, active & light.is_area)
    if lights.has_point:
        _emit_point(result, light, u_direction, active & light.is_point)
    if lights.has_infinite:
        _emit_infinite(result, lights, light, u_point, u_direction, active & light.is_infinite)
    if lights.has_beam:
        _emit_beam(result, light, u_point, active & light.is_beam)
    result.active &= ~dr.all(result.throughput == 0.0)
    return result


def _emit_area(out: EmittedRay, lights: LightTable, light: Light, u_point: Any, u_direction: Any, mask: Any) -> None:
    place, triangle, area_density = _place(lights, light, u_point, mask)
    local = light.direction(u_direction)
    cos = mi.Frame3f.cos_theta(local)
    direction_pdf = light.direction_pdf(cos)

    def emitted(emitter: Any, triangle: Any, place: Any, wi: Any, mask: Any) -> tuple[Any, ...]:
        si = _light_point(emitter, triangle, place, mask)
        si.wi = wi
        return si.p, si.n, emitter.eval(si, mask)

    p, n, radiance = dr.dispatch(light.emitter, emitted, triangle, place, local, mask)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p, si.n, si.sh_frame = p, n, mi.Frame3f(n)
    out.ray[mask] = si.spawn_ray(si.to_world(local))
    out.throughput[mask] = radiance * (cos / (area_density * direction_pdf))
    out.area_density[mask] = area_density
    out.emission_density[mask] = area_density * direction_pdf
    out.cos_light[mask] = cos
    out.active &= ~mask | (cos > 0.0)


def point_on(lights: LightTable, light: Light, u: Any, mask: Any) -> tuple[Any, Any]:
    """A point drawn on an area light as emission draws it: (interaction, area density, picking included)."""
    place, triangle, density = _place(lights, light, u, mask)

    def point(emitter: Any, triangle: Any, place: Any, mask: Any) -> tuple[Any, ...]:
        si = _light_point(emitter, triangle, place, mask)
        return si.p, si.n, si.uv, si.prim_index

    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
    si.p, si.n, si.uv, si.prim_index = dr.dispatch(light.emitter, point, triangle, place, mask)
    if lights.points is not None:  # radiance may be an attribute of the mesh
        si.shape = light.emitter.get_shape()
    return si, density


def _place(lights: LightTable | LocalLights, light: Light, u: Any, mask: Any) -> tuple[Any, Any, Any]:
    """Where on an area light ``u`` falls: (place, triangle, area density, picking included)."""
    density = light.pick * light.area_density
    if lights.points is None:
        return u, mi.UInt32(0), density
    place, triangle, factor = lights.points.draw(light.row, u, mask)
    return place, triangle, density * factor


def _light_point(emitter: Any, triangle: Any, place: Any, mask: Any) -> Any:
    """A point of an emitter's shape; a call is traced for every emitter there is, those without shape too."""
    shape = emitter.get_shape()
    if shape is None:
        return dr.zeros(mi.SurfaceInteraction3f)
    if varies(emitter):
        return surface_point(shape, triangle, place, mask)
    return uniform_point(shape, place, mask)


def _emit_point(out: EmittedRay, light: Light, u_direction: Any, mask: Any) -> None:
    # The spot takes its direction from the first pair of numbers, the others from the second.
    ray, weight = _own_ray(light, mi.EmitterFlags.DeltaPosition, u_direction, mask)
    out.ray[mask] = ray
    out.throughput[mask] = weight / light.pick
    out.area_density[mask] = light.pick
    out.emission_density[mask] = light.pick * light.direction_density


def _emit_beam(out: EmittedRay, light: Light, u_point: Any, mask: Any) -> None:
    ray, weight = _own_ray(light, mi.EmitterFlags.DeltaDirection, u_point, mask)
    out.ray[mask] = ray
    out.throughput[mask] = weight / light.pick
    out.area_density[mask] = 0.0  # next event cannot choose the point that shines on another
    out.emission_density[mask] = light.pick * light.area_density


def _own_ray(light: Light, kind: Any, u: Any, mask: Any) -> tuple[Any, Any]:
    """A ray as an emitter of a kind samples it: (ray, weight)."""

    def sample(emitter: Any, u: Any, mask: Any) -> tuple[Any, Any]:
        if not mi.has_flag(emitter.flags(), kind):  # the texture of an area light may be unable to
            return dr.zeros(mi.Ray3f), mi.Color3f(0.0)
        return emitter.sample_ray(0.0, 0.5, u, u, mask)

    return dr.dispatch(light.emitter, sample, u, mask)


def _emit_infinite(
    out: EmittedRay, lights: LightTable, light: Light, u_point: Any, u_direction: Any, mask: Any
) -> None:
    centre = dr.zeros(mi.Interaction3f)
    centre.p = mi.Point3f(lights.centre)
    ds, weight = light.emitter.sample_direction(centre, u_direction, mask)
    # A disc of the scene's radius, perpendicular to the direction, just outside the scene.
    disc = mi.warp.square_to_uniform_disk_concentric(u_point) * lights.radius
    frame = mi.Frame3f(ds.d)
    origin = centre.p + frame.to_world(mi.Vector3f(disc.x, disc.y, lights.radius))
    direction_density = light.pick * ds.pdf
    usable = mask & (ds.pdf > 0.0)
    out.ray[usable] = mi.Ray3f(origin, -ds.d)
    out.throughput[usable] = weight / (light.pick * light.area_density)
    out.area_density[usable] = direction_density
    out.emission_density[usable] = direction_density * light.area_density


def sample_direct(
    lights: LightTable | LocalLights, si: Any, source: SampleSource, vertex: Any, index: int, active: Any
) -> DirectSample:
    """Sample a light point for the surface point ``si``: the ``index``-th next-event sample of ``vertex``."""
    component = dim.NEXT_EVENT + 4 * index
    u_point = mi.Point2f(*source.next_2d(vertex, component + 1))
    light = lights.pick(source.next_1d(vertex, component), active)
    n = dr.width(u_point)
    result = DirectSample(
        direction=dr.zeros(mi.Vector3f, n),
        target=dr.zeros(mi.Point3f, n),
        light=light.row,
        radiance=dr.zeros(mi.Color3f, n),
        pdf=dr.full(mi.Float, 1.0, n),
        light_ratio=dr.zeros(mi.Float, n),
        is_delta=mi.Bool(light.is_delta),
        active=mi.Bool(active),
    )
    if lights.has_area:
        _direct_area(result, lights, light, si, u_point, active & light.is_area)
    if lights.has_point:
        _direct_point(result, light, si, u_point, active & light.is_point)
    if lights.has_infinite:
        _direct_infinite(result, light, si, u_point, active & light.is_infinite)
    result.active &= ~dr.all(result.radiance == 0.0)
    return result


def _direct_area(
    out: DirectSample, lights: LightTable | LocalLights, light: Light, si: Any, u_point: Any, mask: Any
) -> None:
    place, triangle, area_density = _place(lights, light, u_point, mask)
    cone = cone_of(light, si.p) if lights.has_sphere else None
    seen = [*point_in(cone, light, u_point), cone.applies] if cone else []

    def lit(emitter: Any, p: Any, triangle: Any, place: Any, seen: list[Any], mask: Any) -> tuple[Any, ...]:
        at_light = _light_point(emitter, triangle, place, mask)
        if seen and _is_sphere(emitter):
            at_light = dr.select(seen[2], sphere_point(emitter.get_shape(), seen[0], seen[1], at_light), at_light)
        offset = at_light.p - p
        distance_squared = dr.squared_norm(offset)
        direction = offset * dr.rsqrt(distance_squared)
        cos = -dr.dot(direction, at_light.n)
        at_light.wi = mi.Vector3f(0.0, 0.0, cos)  # no emitter asks for more than the cosine
        radiance = emitter.eval(at_light, mask & (cos > 0.0))
        return at_light.p, at_light.uv, direction, distance_squared, cos, radiance

    found = dr.dispatch(light.emitter, lit, si.p, triangle, place, seen, mask)
    target, uv, direction, distance_squared, cos, radiance = found
    mask = mask & (cos > 0.0)
    pdf = area_density * distance_squared / dr.select(mask, cos, 1.0)
    ratio = light.direction_pdf(cos) / distance_squared
    if cone:
        emission = _area_density(lights, light, uv, mi.UInt32(0), mask) * light.direction_pdf(cos)
        pdf = dr.select(cone.applies, light.pick * cone.density, pdf)
        ratio = dr.select(cone.applies, emission / (pdf * cos), ratio)
    out.direction[mask] = direction
    out.target[mask] = target
    out.radiance[mask] = radiance / pdf
    out.pdf[mask] = pdf
    out.light_ratio[mask] = ratio


def _is_sphere(emitter: Any) -> bool:
    shape = emitter.get_shape()
    return shape is not None and graph.plugin_name(shape) == "sphere"


def _area_density(lights: LightTable | LocalLights, light: Light, uv: Any, triangle: Any, mask: Any) -> Any:
    """Density by area, picking included, with which emission draws a point of an area light."""
    density = light.pick * light.area_density
    return density if lights.points is None else density * lights.points.factor(light.row, uv, triangle, mask)


def _direct_point(out: DirectSample, light: Light, si: Any, u_point: Any, mask: Any) -> None:
    ds, weight = light.emitter.sample_direction(si, u_point, mask)
    distance_squared = dr.square(ds.dist)
    out.direction[mask] = ds.d
    out.target[mask] = ds.p
    out.radiance[mask] = weight / light.pick
    out.pdf[mask] = light.pick * distance_squared
    out.light_ratio[mask] = light.direction_density / distance_squared


def _direct_infinite(out: DirectSample, light: Light, si: Any, u_point: Any, mask: Any) -> None:
    ds, weight = light.emitter.sample_direction(si, u_point, mask)
    usable = mask & (ds.pdf > 0.0)
    out.direction[usable] = ds.d
    out.target[usable] = ds.p
    out.radiance[usable] = weight / light.pick
    out.pdf[usable] = light.pick * ds.pdf
    out.light_ratio[usable] = light.area_density


def is_emissive(scene: Any, si: Any) -> Any:
    """Lanes whose ray reached an emitter, the environment of a miss included."""
    return dr.reinterpret_array(mi.UInt32, si.emitter(scene)) != 0


def emission_of_hit(
    lights: LightTable | LocalLights, scene: Any, si: Any, active: Any, distance: Any = None
) -> tuple[Any, Any, Any]:
    """What a ray that reached ``si`` sees of a light: (radiance, area density, emission density).

    ``si`` may be a miss, where the environment is seen; its densities are those of the direction [Georgiev 2012b, 43].
    ``active`` marks the lanes whose ``si.emitter(scene)`` is not null. ``distance`` is the length of the edge, that of
    the ray if it is not given; the area density is that of next event from where the edge begins.
    """
    emitter = si.emitter(scene)
    light = lights.of(emitter, active)
    radiance = emitter.eval(si, active)
    area_density = point_density = _area_density(lights, light, si.uv, si.prim_index, active)
    emission_density = point_density * light.direction_pdf(dr.maximum(mi.Frame3f.cos_theta(si.wi), 0.0))
    if lights.has_sphere:
        back, length = si.to_world(si.wi), si.t if distance is None else distance
        area_density = seen_density(light, si.p + back * length, -back, length, point_density)
    if lights.has_infinite:
        infinite = active & light.is_infinite
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = -si.wi
        reference = dr.zeros(mi.Interaction3f)
        direction_density = light.pick * emitter.pdf_direction(reference, ds, infinite)
        area_density = dr.select(infinite, direction_density, area_density)
        emission_density = dr.select(infinite, direction_density * light.area_density, emission_density)
    return radiance, area_density, emission_density
