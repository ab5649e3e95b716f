"""Light of skies and suns through openings, found before the first pass by a pilot of camera paths."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import IndependentSource, Settings, logger, setting
from etendue.density import LEAST_LINES
from etendue.scene import LightTable, brightness
from etendue.transport import DirectWeights, Lines, OpeningWalk, Surroundings, surroundings

from .base import ImageMethod

#: Camera paths of a pilot, pilots at most, and lines after which there are no more; camera rays that look around.
_PATHS, _PILOTS, _ENOUGH, _RAYS = 1 << 16, 16, 1 << 11, 1 << 12
#: Share of the sky that is seen from the surfaces in the picture above which nothing is learned; that for a sky without
#: a sun if its light is also sampled at the camera's side: light paths are then worth less than they cost.
_OPEN, _EVEN = 0.25, 0.003


@dataclass(frozen=True)
class OpeningSettings(Settings):
    """Settings of the methods whose light paths look for openings."""

    openings: bool = setting(
        True,
        "where walls hide most of the sky, find by camera paths through which windows light of skies and suns enters, "
        "and emit most of its light paths there",
    )

    @property
    def samples_sky(self) -> bool:
        """Whether next event estimation samples the sky, too."""
        return False


def through_openings(method: ImageMethod, seed: int) -> LightTable:
    """The lights of a prepared method with :class:`OpeningSettings`. Rays of infinite ones have the places of the lines
    along which camera paths have found them, if the surfaces in the picture see little of the sky, and if that makes
    these lines much likelier."""
    method.notes.pop("openings", None)  # of the scene before
    lights = method.lights
    o = method.settings
    if not (isinstance(o, OpeningSettings) and o.openings and lights.has_infinite) or lights.is_black:
        return lights
    if look_around(method, seed).sky > (_EVEN if o.samples_sky and not lights.has_sun else _OPEN):
        return lights
    found = _lines(method, seed).fitted(lights)
    if found is None:
        logger.debug("openings: none")
        return lights
    lights, gain = found
    logger.info("openings: the lines along which camera paths see the sky are sampled %.0f times as often", gain)
    method.notes["openings"] = float(f"{gain:.3g}")
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
    return Lines.of(path)


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
