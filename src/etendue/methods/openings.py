"""Windows, found by a pilot of camera paths before the first pass: there light paths of skies and suns enter, and next
event looks for skies. And mirrors and glass on which a sun shines, where its light paths go."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import IndependentSource, Settings, copied_to_device, logger, own_kernels, setting
from etendue.density import LEAST_LINES
from etendue.scene import LightTable, brightness, corners_of, graph
from etendue.transport import DirectWeights, Lines, OpeningWalk, Surroundings, dimensions as dim, emit, surroundings

from .base import ImageMethod

#: Camera paths of a pilot, pilots at most, and lines after which there are no more; camera rays that look around.
_PATHS, _PILOTS, _ENOUGH, _RAYS = 1 << 16, 16, 1 << 11, 1 << 12
#: Share of the sky that is seen from the surfaces in the picture above which nothing is learned; that for a sky without
#: a sun if its light is also sampled at the camera's side: light paths are then worth less than they cost.
_OPEN, _EVEN = 0.25, 0.003
#: Camera paths of a run up to which, and seconds below which it is too short for a pilot that only saves noise.
PREVIEW, _SHORT = 1 << 20, 3.0
#: Share of the light of infinite lights that reaches mirrors and glass above which no light paths are aimed at them.
_CASTERS = 0.2


@dataclass(frozen=True)
class OpeningSettings(Settings):
    """Settings of the methods that look for openings."""

    openings: bool = setting(
        True,
        "where walls hide most of the sky, find windows by camera paths: light paths of skies and suns enter there; "
        "bpt, vcm and auto also sample the sky through them, and aim light paths of suns at mirrors and glass",
    )

    @property
    def samples_sky(self) -> bool:
        """Whether next event estimation samples the sky, too."""
        return False

    @property
    def has_light_paths(self) -> bool:
        """Whether the method traces light paths."""
        return True


def camera_paths_of(method: ImageMethod, passes: int | None) -> float:
    """Camera paths of a run of a prepared method."""
    return math.inf if passes is None else passes * method.samples_per_iteration * method.camera.pixels


def is_short(method: ImageMethod, seconds: float | None, passes: int | None) -> bool:
    """Whether a run, as told to :meth:`Method.plan`, is too short to look for windows."""
    return camera_paths_of(method, passes) <= PREVIEW or (seconds is not None and seconds < _SHORT)


@own_kernels(optimise=False)  # a few passes
def through_openings(method: ImageMethod, seed: int) -> LightTable:
    """The lights of a prepared method with :class:`OpeningSettings`. Rays of infinite ones have the places of the lines
    along which camera paths have found them, if the surfaces in the picture see little of the sky, and of those of suns
    that meet mirrors and glass; both if that makes these lines much likelier. Next event's directions to skies pass the
    windows of these lines."""
    lights = method.lights
    o = method.settings
    if not (isinstance(o, OpeningSettings) and o.openings and lights.has_infinite) or lights.is_black:
        return lights
    by_next_event = o.samples_sky and lights.sky is not None
    if not (by_next_event or o.has_light_paths):
        return lights
    around = look_around(method, seed)
    sky = around.sky
    seen = _lines(method, seed) if sky <= _OPEN else None
    if o.has_light_paths:
        both = [_to_casters(method, seed)] if lights.has_sun and o.samples_sky else []
        # Without next event, light paths have to light everything else as well.
        if seen and sky <= (_EVEN if o.samples_sky and not lights.has_sun else _OPEN):
            both.append(seen)
        found = Lines.alike([lines for lines in both if lines]).fitted(lights)
        if found:
            lights, gain = found
            logger.info("openings: lines to windows, mirrors and glass are sampled %.0f times as often", gain)
            method.notes["openings"] = float(f"{gain:.3g}")
    if seen and by_next_event and (found := seen.windows(lights, (around.lower, around.upper))):
        lights, gain = found
        logger.info("openings: directions to the sky through windows are sampled %.1f times as often", gain)
        method.notes["windows"] = float(f"{gain:.3g}")
    return lights


def _lines(method: ImageMethod, seed: int) -> Lines:
    """Lines to infinite lights by a pilot of camera paths; by more of them if it finds few, unless all together would
    not find enough."""
    lines = _pilot(method, seed, 0)
    if len(lines) * _PILOTS < LEAST_LINES:
        return lines
    for number in range(1, _PILOTS):
        if len(lines) >= _ENOUGH:
            break
        lines = lines + _pilot(method, seed, number)
    return lines


def _pilot(method: ImageMethod, seed: int, number: int) -> Lines:
    source = IndependentSource(dr.arange(mi.UInt32, _PATHS), seed, "openings", number)
    ray, importance = _camera_rays(method, source, _PATHS)
    path = method.walker(OpeningWalk, weights=DirectWeights()).trace(ray, source)
    path.total *= brightness(importance)
    return Lines.of(path.origin, path.direction, path.total, path.picked, path.scattered)


def _to_casters(method: ImageMethod, seed: int) -> Lines | None:
    """Lines of infinite lights to the mirrors and glass that they shine on, whose caustics are noise if few light paths
    meet them; None if many do anyway."""
    boxes = [corners_of(shape) for shape in graph.shapes(method.scene) if _focuses(shape.bsdf())]
    if not boxes:
        return None
    corners = np.array(boxes, np.float32)
    radius = 0.5 * np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    balls = copied_to_device(mi.Float, np.column_stack([corners.mean(axis=1), radius]))

    # Rays of the lights through the balls around the shapes, each of which gets equally many.
    source = IndependentSource(dr.arange(mi.UInt32, _PATHS), seed, "casters", 0)
    emitted = emit(method.lights, source, mi.Bool(True))
    d, active = emitted.ray.d, emitted.active & emitted.is_infinite
    count = dr.opaque(mi.UInt32, len(boxes))
    pick = dr.minimum(mi.UInt32(source.next_1d(0, dim.APERTURE) * mi.Float(count)), count - 1)
    ball = dr.gather(mi.Vector4f, balls, pick, active)
    disc = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(*source.next_2d(0, dim.FILM))) * ball.w
    place = mi.Point3f(ball.xyz) + mi.Frame3f(d).to_world(mi.Vector3f(disc.x, disc.y, 0.0))
    ray = mi.Ray3f(place - d * (2.0 * dr.opaque(mi.Float, method.lights.radius)), d)
    si = method.scene.ray_intersect(ray, active)
    found = active & si.is_valid() & _focusing(si.bsdf(ray).flags())
    flux = dr.select(active, brightness(emitted.throughput), 0.0)
    lines = Lines.of(si.p, -d, dr.select(found, flux * dr.square(ball.w), 0.0))
    even = float(np.array(flux, np.float64).sum()) * method.lights.radius**2
    return lines if len(boxes) * lines.value.sum() < _CASTERS * even else None


def _focuses(bsdf: mi.BSDF | None) -> bool:
    """Whether a material only mirrors and refracts, see :func:`_focusing`."""
    return bsdf is not None and bool(_focusing(mi.UInt32(bsdf.flags()))[0])


def _focusing(flags: mi.UInt32) -> mi.Bool:
    """Whether flags are those of a material that only mirrors and refracts, smooth or rough, and is no thin pane."""
    wanted, other = mi.BSDFFlags.Delta | mi.BSDFFlags.Glossy, mi.BSDFFlags.Diffuse | mi.BSDFFlags.Null
    return ((flags & mi.UInt32(int(wanted))) != 0) & ((flags & mi.UInt32(int(other))) == 0)


def look_around(method: ImageMethod, seed: int) -> Surroundings:
    """What surrounds the camera of a prepared method."""
    source = IndependentSource(dr.arange(mi.UInt32, _RAYS), seed, "surroundings", 0)
    return surroundings(method.scene, _camera_rays(method, source, _RAYS)[0], source)


def _camera_rays(method: ImageMethod, source: IndependentSource, count: int) -> tuple[mi.Ray3f, mi.Spectrum]:
    """Rays and their weights through ``count`` pixels all over the picture."""
    pixels = method.camera.pixels
    pixel = mi.UInt32((mi.Float(dr.arange(mi.UInt32, count)) + 0.5) * dr.opaque(mi.Float, pixels / count))
    ray, importance, _ = method.camera.primary(dr.minimum(pixel, dr.opaque(mi.UInt32, pixels - 1)), source)
    return ray, importance
