"""Points on area lights, and the densities of next event and of emission at a light.

Next event and emission may pick lights with different probabilities (:class:`~etendue.scene.Light`), and emission may
have learned directions of departure.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from etendue.scene import Light, LightsAt, LightTable, front, graph, has_cells, is_smooth, surface_point, uniform_point

from ..guiding.departure import Departures


def point_on(
    lights: LightTable, light: Light, u: mi.Point2f, mask: mi.Bool
) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
    """A point on an area light, sampled as for emission: (interaction, area density times ``light.pick``)."""
    place, triangle, density = place_on(lights, light, light.pick, u, mask)

    def point(
        emitter: mi.Emitter, triangle: mi.UInt32, place: mi.Point2f, mask: mi.Bool
    ) -> tuple[mi.Point3f, mi.Normal3f, mi.Normal3f, mi.Point2f, mi.UInt32, mi.ShapePtr]:
        si = light_point(emitter, triangle, place, mask)
        return si.p, si.n, si.sh_frame.n, si.uv, si.prim_index, mi.ShapePtr(emitter.get_shape())

    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
    found = light.call("area", point, triangle, place, active=mask)
    si.p, si.n, si.sh_frame.n, si.uv, si.prim_index, shape = found
    if lights.points is not None:  # the radiance may be an attribute of the mesh
        si.shape = shape
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
    """A point of an area light's shape. Both normals are on the side that emits; cosines and densities are of ``n``,
    and the interpolated normal decides beside it where a mesh with vertex normals emits (:func:`facing`)."""
    shape = emitter.get_shape()
    if not has_cells(emitter):
        return uniform_point(shape, place, mask)
    si = surface_point(shape, triangle, place, mask)
    if is_smooth(emitter):
        si.n = front(si)
    return si


def facing(emitter: mi.Emitter, si: mi.SurfaceInteraction3f, direction: mi.Vector3f, cos: mi.Float) -> mi.Vector3f:
    """The local direction ``wi`` for which an emitter is evaluated at a :func:`light_point`, towards a world direction
    with cosine ``cos`` to the face; emitters use its cosine only, that to the interpolated normal."""
    return mi.Vector3f(0.0, 0.0, dr.dot(direction, si.sh_frame.n) if is_smooth(emitter) else cos)


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
    """Whether an area light is spherical."""
    return graph.plugin_name(emitter.get_shape()) == "sphere"


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
