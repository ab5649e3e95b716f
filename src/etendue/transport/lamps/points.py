"""Points on area lights, and the densities of next event and of emission at a light.

Next event and emission may pick lights with different probabilities (:class:`~etendue.scene.Light`), and emission may
have learned directions of departure.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from etendue.scene import Light, LightsAt, LightTable, graph, surface_point, uniform_point, varies

from ..guiding.departure import Departures


def point_on(
    lights: LightTable, light: Light, u: mi.Point2f, mask: mi.Bool
) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
    """A point on an area light, sampled as for emission: (interaction, area density times ``light.pick``)."""
    place, triangle, density = place_on(lights, light, light.pick, u, mask)

    def point(
        emitter: mi.Emitter, triangle: mi.UInt32, place: mi.Point2f, mask: mi.Bool
    ) -> tuple[mi.Point3f, mi.Normal3f, mi.Point2f, mi.UInt32]:
        si = light_point(emitter, triangle, place, mask)
        return si.p, si.n, si.uv, si.prim_index

    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
    si.p, si.n, si.uv, si.prim_index = dr.dispatch(light.emitter, point, triangle, place, mask)
    if lights.points is not None:  # the radiance may be an attribute of the mesh
        si.shape = light.emitter.get_shape()
    return si, density


def place_on(
    lights: LightTable | LightsAt, light: Light, chance: mi.Float, u: mi.Point2f, mask: mi.Bool
) -> tuple[mi.Point2f, mi.UInt32, mi.Float]:
    """The point of an area light that ``u`` selects: (place, triangle, area density times the light's probability
    ``chance``)."""
    density = chance * light.area_density
    if lights.points is None:
        return u, mi.UInt32(0), density
    place, triangle, factor = lights.points.draw(light.row, u, mask)
    return place, triangle, density * factor


def light_point(emitter: mi.Emitter, triangle: mi.UInt32, place: mi.Point2f, mask: mi.Bool) -> mi.SurfaceInteraction3f:
    """A point of an emitter's shape."""
    shape = emitter.get_shape()  # None for some emitters: Dr.Jit traces the call for each emitter of the scene
    if shape is None:
        return dr.zeros(mi.SurfaceInteraction3f)
    if varies(emitter):
        return surface_point(shape, triangle, place, mask)
    return uniform_point(shape, place, mask)


def of_next_event(light: Light, density: mi.Float) -> mi.Float:
    """A density with light selection by emission, converted to light selection by next event."""
    return density if light.emitted is light.pick else density * (light.pick / light.emitted)


def departing(
    departures: Departures | None, light: Light, own: mi.Float, direction: mi.Vector3f, mask: mi.Bool
) -> mi.Float:
    """Solid-angle density with which emission samples a world ``direction`` at a point of a light; ``own``: the density
    of the light's kind."""
    return own if departures is None else departures.at(light.row, mask).mixed(direction, own, mask)


def of_emission(light: Light, density: mi.Float) -> mi.Float:
    """Inverse of :func:`of_next_event`."""
    return density if light.emitted is light.pick else density * (light.emitted / light.pick)


def is_sphere(emitter: mi.Emitter) -> bool:
    """Whether an emitter is a spherical light."""
    shape = emitter.get_shape()
    return shape is not None and graph.plugin_name(shape) == "sphere"


def area_density_on(
    lights: LightTable | LightsAt,
    light: Light,
    chance: mi.Float,
    uv: mi.Point2f,
    triangle: mi.UInt32,
    mask: mi.Bool,
) -> mi.Float:
    """Area density with which emission samples a point of an area light, times the light's probability ``chance``."""
    density = chance * light.area_density
    return density if lights.points is None else density * lights.points.factor(light.row, uv, triangle, mask)
