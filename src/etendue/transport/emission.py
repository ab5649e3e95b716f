"""Emission: rays sampled from lights, light points for next event, and the densities of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import Light, LightsAt, LightTable, front, own_ray, sphere_point, sphere_point_facing

from . import dimensions as dim
from .guiding.departure import Departure, Departures
from .lamps.points import (
    area_density_on,
    departing,
    facing,
    is_sphere,
    light_point,
    of_emission,
    of_next_event,
    place_on,
)
from .lamps.spheres import cone_of, point_in, seen_density


@dataclass
class EmittedRay:
    """A ray sampled from the lights, one lane each."""

    ray: mi.Ray3f
    light: mi.UInt32  #: number of the light
    throughput: mi.Spectrum  #: emitted radiance times cosine over the density, a flux
    direction_pdf: mi.Float  #: solid-angle density of the direction at the light; 1 for infinite lights and beams
    own_pdf: mi.Float  #: the same without learned directions
    #: Density of the light point under next event, light selection included (infinite lights: of the direction). For a
    #: spherical light this is the density under emission, because that of next event depends on the lit point (see
    #: :mod:`.lamps.spheres`).
    area_density: mi.Float
    emission_density: mi.Float  #: density of point and direction, light selection included
    cos_light: mi.Float  #: cosine at the light; 1 where the light has no surface
    is_delta: mi.Bool
    is_infinite: mi.Bool
    active: mi.Bool


@dataclass
class DirectSample:
    """A light point sampled by next event at a surface point, one lane each."""

    direction: mi.Vector3f  #: world, towards the light
    target: mi.Point3f  #: end point of the shadow ray
    light: mi.UInt32  #: number of the light
    radiance: mi.Spectrum  #: incident radiance without occlusion, over ``pdf``
    pdf: mi.Float  #: solid-angle density of the direction, light selection included
    light_ratio: mi.Float  #: emission density over (``pdf`` times cosine at the light)
    is_delta: mi.Bool
    active: mi.Bool


def emit(lights: LightTable, source: SampleSource, active: mi.Bool, departures: Departures | None = None) -> EmittedRay:
    """Sample a ray from the lights: the emitter by the table's probabilities, then point and direction by the emitter's
    kind. ``departures``: learned directions, mixed with the directions of the emitter's kind."""
    light = lights.pick_emitting(source.next_1d(0, dim.LIGHT_PICK), active)
    u_point = mi.Point2f(*source.next_2d(0, dim.LIGHT_POINT))
    u_direction = mi.Point2f(*source.next_2d(0, dim.LIGHT_DIRECTION))
    n = dr.width(u_point)
    result = EmittedRay(
        ray=dr.zeros(mi.Ray3f, n),
        light=light.row,
        throughput=dr.zeros(mi.Spectrum, n),
        direction_pdf=dr.full(mi.Float, 1.0, n),
        own_pdf=dr.full(mi.Float, 1.0, n),
        area_density=dr.full(mi.Float, 1.0, n),
        emission_density=dr.full(mi.Float, 1.0, n),
        cos_light=dr.full(mi.Float, 1.0, n),
        is_delta=mi.Bool(light.is_delta),
        is_infinite=mi.Bool(light.is_infinite),
        active=mi.Bool(active),
    )
    learned = None
    if departures is not None:
        learned = departures.sample(light.row, u_direction, source.decide(0, dim.LIGHT_GUIDE), active)
    if lights.has_area:
        _emit_area(result, lights, light, u_point, u_direction, learned, active & light.is_area)
    if lights.has_point:
        _emit_point(result, light, u_direction, learned, active & light.is_point)
    if lights.has_infinite:
        _emit_infinite(result, lights, light, u_point, u_direction, source, active & light.is_infinite)
    if lights.has_beam:
        _emit_beam(result, light, u_point, active & light.is_beam)
    result.ray.wavelengths = lights.packet.wavelengths
    result.active &= ~dr.all(result.throughput == 0.0)
    return result


def _emit_area(
    out: EmittedRay,
    lights: LightTable,
    light: Light,
    u_point: mi.Point2f,
    u_direction: mi.Point2f,
    learned: Departure | None,
    mask: mi.Bool,
) -> None:
    place, triangle, area_density = place_on(lights, light, light.emitted, u_point, mask)
    own = light.direction(u_direction)
    guided: list[Any] = []
    if learned is not None:
        # On a sphere, the normal is distributed around the direction as directions are around the normal of a point.
        normal = mi.Frame3f(learned.direction).to_world(light.direction(u_point))
        guided = [learned.direction, learned.applies, normal, learned.applies & learned.is_round]

    def emitted(
        emitter: mi.Emitter,
        triangle: mi.UInt32,
        place: mi.Point2f,
        own: mi.Vector3f,
        guided: list[Any],
        wavelengths: mi.Color0f,
        mask: mi.Bool,
    ) -> tuple[mi.Point3f, mi.Normal3f, mi.Vector3f, mi.Spectrum]:
        si = light_point(emitter, triangle, place, mask)
        if guided and is_sphere(emitter):
            si = dr.select(guided[3], sphere_point_facing(emitter.get_shape(), guided[2], si), si)
        frame = mi.Frame3f(si.n)
        local = dr.select(guided[1], frame.to_local(guided[0]), own) if guided else own
        si.wi = facing(emitter, si, frame.to_world(local), mi.Frame3f.cos_theta(local))
        si.wavelengths = wavelengths
        return si.p, si.n, local, emitter.eval(si, mask)

    arguments = triangle, place, own, guided, light.packet.wavelengths
    p, n, local, radiance = light.call("area", emitted, *arguments, active=mask)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p, si.n, si.sh_frame = p, n, mi.Frame3f(n)
    cos = mi.Frame3f.cos_theta(local)
    direction_pdf = light.direction_pdf(cos)
    out.own_pdf[mask] = direction_pdf
    if learned is not None:
        mask = mask & (cos > 0.0)
        direction_pdf = learned.mixed(si.to_world(local), dr.maximum(direction_pdf, 0.0), mask)
        direction_pdf = dr.select(direction_pdf > 0.0, direction_pdf, 1.0)
    out.ray[mask] = si.spawn_ray(si.to_world(local))
    out.throughput[mask] = radiance * (cos / (area_density * direction_pdf))
    out.direction_pdf[mask] = direction_pdf
    out.area_density[mask] = of_next_event(light, area_density)
    out.emission_density[mask] = area_density * direction_pdf
    out.cos_light[mask] = cos
    out.active &= ~mask | (cos > 0.0)


def _emit_point(
    out: EmittedRay, light: Light, u_direction: mi.Point2f, learned: Departure | None, mask: mi.Bool
) -> None:
    ray, weight = _own_ray(light, "point", u_direction, mask)
    own = direction_density = light.ray_density(ray.d, mask)
    if learned is not None:
        # The emitter gives the intensity at distance 1; ``weight`` is divided by the density of the mixture below.
        probe = dr.zeros(mi.Interaction3f)
        probe.p, probe.wavelengths = ray.o + learned.direction, ray.wavelengths
        guided = mask & learned.applies
        ds, intensity = light.sample_direction("point", probe, u_direction, guided)
        weight = dr.select(guided, intensity * dr.square(ds.dist), weight * own)
        ray.d = dr.select(guided, learned.direction, ray.d)
        own = dr.select(guided, light.ray_density(learned.direction, guided), own)
        lit = dr.any(weight > 0.0)  # a spot light has no density outside its cone
        direction_density = learned.mixed(ray.d, dr.select(lit, own, 0.0), mask)
        weight /= dr.select(direction_density > 0.0, direction_density, 1.0)
        ray = mi.Ray3f(ray.o, ray.d, 0.0, ray.wavelengths)
    direction_density = dr.select(direction_density > 0.0, direction_density, 1.0)
    out.own_pdf[mask] = own
    out.ray[mask] = ray
    out.throughput[mask] = weight / light.emitted
    out.direction_pdf[mask] = direction_density
    out.area_density[mask] = light.pick
    out.emission_density[mask] = light.emitted * direction_density


def _emit_beam(out: EmittedRay, light: Light, u_point: mi.Point2f, mask: mi.Bool) -> None:
    ray, weight = _own_ray(light, "beam", u_point, mask)
    out.ray[mask] = ray
    out.throughput[mask] = weight / light.emitted
    out.area_density[mask] = 0.0  # next event cannot sample a beam
    out.emission_density[mask] = light.emitted * light.area_density


def _own_ray(light: Light, kind: str, u: mi.Point2f, mask: mi.Bool) -> tuple[mi.Ray3f, mi.Spectrum]:
    """A ray sampled by the emitter itself, for emitters of a kind: (ray, weight)."""

    def sample(
        emitter: mi.Emitter, u: mi.Point2f, wavelengths: mi.Color0f, mask: mi.Bool
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        # The same pair twice: spot reads its direction from the first one, others from the second.
        return own_ray(emitter, u, u, wavelengths, mask)

    ray, weight = light.call(kind, sample, u, light.packet.wavelengths, active=mask)
    return ray, weight


def _emit_infinite(
    out: EmittedRay,
    lights: LightTable,
    light: Light,
    u_point: mi.Point2f,
    u_direction: mi.Point2f,
    source: SampleSource,
    mask: mi.Bool,
) -> None:
    centre = dr.zeros(mi.Interaction3f)
    centre.p, centre.wavelengths = mi.Point3f(lights.bound.xyz), lights.packet.wavelengths
    ds, weight = light.sample_direction("infinite", centre, u_direction, mask)
    usable = mask & (ds.pdf > 0.0)
    # A disc of the scene's radius, perpendicular to the direction, that touches the bounding sphere.
    disc = mi.warp.square_to_uniform_disk_concentric(u_point) * lights.bound.w
    place = centre.p + mi.Frame3f(ds.d).to_world(mi.Vector3f(disc.x, disc.y, 0.0))
    if lights.lines is not None:
        lines, share = lights.lines
        learned = usable & (source.decide(0, dim.LIGHT_GUIDE) < share)
        pick, depth = source.next_2d(0, dim.LIGHT_CELL)
        place = dr.select(learned, lines.sample(pick, mi.Point3f(u_point.x, u_point.y, depth), learned), place)
    # Of the place itself: far from it, at the origin of the ray, rounding may lead out of its cell.
    place_density = _place_density(lights, light, place, ds.d, usable)
    origin = place + ds.d * (lights.bound.w - dr.dot(place - centre.p, ds.d))
    direction_density = light.emitted * ds.pdf
    out.ray[usable] = mi.Ray3f(origin, -ds.d)
    out.throughput[usable] = weight / (light.emitted * place_density)
    out.area_density[usable] = light.pick * ds.pdf
    out.emission_density[usable] = direction_density * place_density


def _place_density(
    lights: LightTable | LightsAt, light: Light, p: mi.Point3f, d: mi.Vector3f, mask: mi.Bool
) -> mi.Float:
    """Density of the place of the ray from an infinite light of direction ``d`` that passes ``p``, on its disc."""
    if lights.lines is None:
        return light.area_density
    lines, share = lights.lines
    return share * lines.along(p, d, mask) + (1.0 - share) * light.area_density


def sample_direct(
    lights: LightTable | LightsAt,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    index: int,
    active: mi.Bool,
    departures: Departures | None = None,
) -> DirectSample:
    """Sample a light point at the surface point ``si``: the ``index``-th next-event sample of ``vertex``.
    ``departures``: as for :func:`emit`, for the density of emission."""
    component = dim.NEXT_EVENT + 4 * index
    u_point = mi.Point2f(*source.next_2d(vertex, component + 1))
    lights = lights.at(si.p)
    light = lights.pick(source.next_1d(vertex, component), active)
    n = dr.width(u_point)
    result = DirectSample(
        direction=dr.zeros(mi.Vector3f, n),
        target=dr.zeros(mi.Point3f, n),
        light=light.row,
        radiance=dr.zeros(mi.Spectrum, n),
        pdf=dr.full(mi.Float, 1.0, n),
        light_ratio=dr.zeros(mi.Float, n),
        is_delta=mi.Bool(light.is_delta),
        active=mi.Bool(active),
    )
    if lights.has_area:
        _direct_area(result, lights, light, si, u_point, departures, active & light.is_area)
    if lights.has_point:
        _direct_point(result, light, si, u_point, departures, active & light.is_point)
    if lights.has_infinite:
        _direct_infinite(result, lights, light, si, source, vertex, index, u_point, active & light.is_infinite)
    result.active &= ~dr.all(result.radiance == 0.0)
    return result


def _direct_area(
    out: DirectSample,
    lights: LightTable | LightsAt,
    light: Light,
    si: mi.SurfaceInteraction3f,
    u_point: mi.Point2f,
    departures: Departures | None,
    mask: mi.Bool,
) -> None:
    place, triangle, area_density = place_on(lights, light, light.pick, u_point, mask)
    cone = cone_of(light, si.p) if lights.has_sphere else None
    seen = [*point_in(cone, light, u_point), cone.applies] if cone else []

    def lit(
        emitter: mi.Emitter,
        p: mi.Point3f,
        triangle: mi.UInt32,
        place: mi.Point2f,
        seen: list[Any],
        wavelengths: mi.Color0f,
        mask: mi.Bool,
    ) -> tuple[mi.Point3f, mi.Point2f, mi.Vector3f, mi.Float, mi.Float, mi.Spectrum]:
        at_light = light_point(emitter, triangle, place, mask)
        if seen and is_sphere(emitter):
            at_light = dr.select(seen[2], sphere_point(emitter.get_shape(), seen[0], seen[1], at_light), at_light)
        offset = at_light.p - p
        distance_squared = dr.squared_norm(offset)
        direction = offset * dr.rsqrt(distance_squared)
        cos = -dr.dot(direction, at_light.n)
        at_light.wi, at_light.wavelengths = facing(emitter, at_light, -direction, cos), wavelengths
        radiance = emitter.eval(at_light, mask & (cos > 0.0))
        return at_light.p, at_light.uv, direction, distance_squared, cos, radiance

    found = light.call("area", lit, si.p, triangle, place, seen, light.packet.wavelengths, active=mask)
    target, uv, direction, distance_squared, cos, radiance = found
    mask = mask & (cos > 0.0)
    pdf = area_density * distance_squared / dr.select(mask, cos, 1.0)
    direction_pdf = departing(departures, light, light.direction_pdf(cos), -direction, mask)
    ratio = of_emission(light, direction_pdf / distance_squared)
    if cone:
        emission = area_density_on(lights, light, light.emitted, uv, mi.UInt32(0), mask) * direction_pdf
        pdf = dr.select(cone.applies, light.pick * cone.density, pdf)
        ratio = dr.select(cone.applies, emission / (pdf * cos), ratio)
    out.direction[mask] = direction
    out.target[mask] = target
    out.radiance[mask] = radiance / pdf
    out.pdf[mask] = pdf
    out.light_ratio[mask] = ratio


def _direct_point(
    out: DirectSample,
    light: Light,
    si: mi.SurfaceInteraction3f,
    u_point: mi.Point2f,
    departures: Departures | None,
    mask: mi.Bool,
) -> None:
    ds, weight = light.sample_direction("point", si, u_point, mask)
    distance_squared = dr.square(ds.dist)
    out.direction[mask] = ds.d
    out.target[mask] = ds.p
    out.radiance[mask] = weight / light.pick
    out.pdf[mask] = light.pick * distance_squared
    direction_density = departing(departures, light, light.ray_density(-ds.d, mask), -ds.d, mask)
    out.light_ratio[mask] = of_emission(light, direction_density / distance_squared)


def _direct_infinite(
    out: DirectSample,
    lights: LightTable | LightsAt,
    light: Light,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    index: int,
    u_point: mi.Point2f,
    mask: mi.Bool,
) -> None:
    through = None
    if lights.windows is not None:
        # One number decides, and goes on as a coordinate of either kind of direction, which keeps both even.
        windows, share = lights.windows
        soft = mask & ~light.is_delta
        through, own_u = soft & (u_point.x < share), (u_point.x - share) / (1.0 - share)
        place = windows.sample(
            mi.Point2f(u_point.x / share, u_point.y), source.decide(vertex, dim.WINDOW[index]), through
        )
        u_point = mi.Point2f(dr.select(soft, dr.clip(own_u, 0.0, 1.0 - 2.0**-24), u_point.x), u_point.y)
    ds, weight = light.sample_direction("infinite", si, u_point, mask)
    usable, d, own = mask & (ds.pdf > 0.0), mi.Vector3f(ds.d), mi.Float(ds.pdf)
    radiance, pdf = weight / light.pick, light.pick * own
    if through is not None:
        d = dr.select(through, dr.normalize(place - si.p), d)
        shone, density = _along(light, d, through)
        own = dr.select(through, density, own)
        pdf = seen_through(lights, light, si.p, d, own, mask)
        usable = mask & (pdf > 0.0)
        radiance = dr.select(through, shone, weight * ds.pdf) / dr.select(usable, pdf, 1.0)
    out.direction[usable] = d
    # Behind all surfaces. Mitsuba's own point may not be: see ``corners_of``.
    out.target[usable] = si.p + d * (2.0 * dr.maximum(lights.bound.w, dr.norm(si.p - lights.bound.xyz)))
    out.radiance[usable] = radiance
    out.pdf[usable] = pdf
    emission = light.emitted * own * _place_density(lights, light, si.p, d, usable)
    out.light_ratio[usable] = emission / dr.select(usable, pdf, 1.0)


def _along(light: Light, d: mi.Vector3f, mask: mi.Bool) -> tuple[mi.Spectrum, mi.Float]:
    """(radiance of an infinite light seen in the direction ``d``, its own solid-angle density there)."""
    si, ds = dr.zeros(mi.SurfaceInteraction3f), dr.zeros(mi.DirectionSample3f)
    si.wi, si.wavelengths, ds.d = -d, light.packet.wavelengths, d

    def seen(
        emitter: mi.Emitter, si: mi.SurfaceInteraction3f, ds: mi.DirectionSample3f, mask: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Float]:
        return emitter.eval(si, mask), emitter.pdf_direction(dr.zeros(mi.Interaction3f), ds, mask)

    radiance, density = light.call("infinite", seen, si, ds, active=mask)
    return radiance, density


def seen_through(
    lights: LightTable | LightsAt, light: Light, o: mi.Point3f, d: mi.Vector3f, own: mi.Float, mask: mi.Bool
) -> mi.Float:
    """Solid-angle density, light selection included, with which next event at ``o`` samples the direction ``d`` to an
    infinite light; ``own``: that of the light without windows."""
    if lights.windows is None:
        return light.pick * own
    windows, share = lights.windows
    soft = mask & ~light.is_delta
    return light.pick * dr.select(soft, share * windows.towards(o, d) + (1.0 - share) * own, own)


def is_emissive(scene: mi.Scene, si: mi.SurfaceInteraction3f) -> mi.Bool:
    """Lanes whose ray has hit an emitter, or has missed the scene and sees the environment."""
    return dr.reinterpret_array(mi.UInt32, si.emitter(scene)) != 0


def emission_of_hit(
    lights: LightTable | LightsAt,
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    active: mi.Bool,
    origin: mi.Point3f,
    distance: mi.Float | None = None,
    departures: Departures | None = None,
) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
    """Emission towards the origin of a ray that hit ``si``: (radiance, area density, emission density).

    ``si`` may be a miss, where the environment is seen; its densities are those of the direction [Georgiev 2012b,
    eq. 43]. ``active``: lanes whose ``si.emitter(scene)`` is not null. ``origin``: start of the edge, for which the
    area density is that of next event. ``distance``: length of the edge, by default that of the ray.
    """
    lights = lights.at(origin)
    light = lights.of(si.emitter(scene), active)
    radiance = light.radiance(si, active)
    area_density = point_density = area_density_on(lights, light, light.pick, si.uv, si.prim_index, active)
    cos = mi.Frame3f.cos_theta(si.wi)
    if lights.has_smooth:
        cos = dr.select(light.is_area, dr.dot(front(si), si.to_world(si.wi)), cos)
        radiance = dr.select(light.is_area & (cos <= 0.0), 0.0, radiance)
    own = light.direction_pdf(dr.maximum(cos, 0.0))
    direction_pdf = departing(departures, light, own, si.to_world(si.wi), active & light.is_area)
    emission_density = of_emission(light, point_density * direction_pdf)
    if lights.has_sphere:
        back, length = si.to_world(si.wi), si.t if distance is None else distance
        area_density = seen_density(light, si.p + back * length, -back, length, point_density)
    if lights.has_infinite:
        infinite = active & light.is_infinite
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = -si.wi
        reference = dr.zeros(mi.Interaction3f)
        of_direction = light.call("infinite", mi.Emitter.pdf_direction, reference, ds, active=infinite)
        by_next_event = seen_through(lights, light, origin, ds.d, of_direction, infinite)
        area_density = dr.select(infinite, by_next_event, area_density)
        by_disc = light.emitted * of_direction * _place_density(lights, light, origin, ds.d, infinite)
        emission_density = dr.select(infinite, by_disc, emission_density)
    return radiance, area_density, emission_density
