"""Radii of merging and gathering, and their units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import IndependentSource, OptionError
from etendue.density import KdTree
from etendue.scene import corners_of, materials
from etendue.transport import Gather, LightVertices, Places, Walker, first_collisions, first_smooth

from .base import ImageMethod

#: The radius in widths of a pixel if the setting is 0, in a picture of so many pixels, and the exponent by which it
#: grows with their number. The best radius of a density estimate of N points in the plane falls with N^(1/6)
#: [Silverman 1986, sec. 4.3]. Light paths are as many as pixels, so that in widths of a pixel it grows with the cube
#: root of their number.
_PIXELS, _PICTURE, _GROWTH = 2.0, 256 * 256, 1.0 / 3.0
#: Names of the units; see :func:`first_radius`.
UNITS = ("scene", "pixel", "absolute")
UNIT_DOC = (
    "unit of a given radius: half the diagonal of the scene's bounding box (scene), the width of a pixel at the "
    "distance of the surface from the camera (pixel), or scene units (absolute)"
)
RADIUS_DOC = "0: by the width of a pixel at the distance of the surface from the camera (2 of them in 256x256 pixels)"
BALL_DOC = "0: so that a ball in which camera paths collide holds a few light vertices"
#: The radius in media over that on surfaces, if the setting is 0: before a pilot, and its limits.
_BALL, _BALLS = 2.0, (0.5, 12.0)
#: Most of such a radius in mean free paths: light changes within one, most of all at a boundary.
_IN_FREE_PATH = 0.1
#: Light vertices in a ball, and the neighbour in a pilot by whose distance their density is measured.
_IN_BALL, _NEIGHBOUR = 2.0, 4
#: Most additional radii of a run; each needs registers and memory.
MORE_RADII = 4
#: Most photons of a pass in a disc that are merged, in the mean over the pixels. Tuned on ``caustics`` and
#: ``water-caustic``, where merging finds most of the light.
_MOST_PHOTONS = 12.0
#: More edges than any light path has.
_ANY_DEPTH = (1 << 16) - 1
#: Share of the pixels that may see something nearer than the distance below which the radius is constant.
_NEAREST = 0.002
#: Distance beyond which the radius is constant, at most, over the distance that a tenth of the pixels and that half of
#: them see nearer surfaces than. The cells of the search grid are as wide as the largest radius everywhere.
_FAR = 4.0, 2.0
#: Least radius over the largest.
_LEAST = 0.01


def factors(text: str) -> tuple[float, ...]:
    """Additional radii of a run, as factors on its radius, from a text such as ``0.5,2``. Raises :class:`OptionError`
    for anything else."""
    words = [word.strip() for word in text.split(",")] if text.strip() else []
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        raise OptionError(f"option 'radii' must be factors on the radius such as 0.5,2, not '{text}'") from None
    if not all(0.0 < value < float("inf") and value != 1.0 for value in values):
        raise OptionError(f"option 'radii' must be factors on the radius above 0 and other than 1, not '{text}'")
    if len({layer(value) for value in values}) < len(values):
        raise OptionError(f"option 'radii' has a factor twice: '{text}'; remove one")
    if len(values) > MORE_RADII:
        raise OptionError(f"option 'radii' can have at most {MORE_RADII} factors, not {len(values)}")
    return values


def layer(factor: float) -> str:
    """Name of the layer of an additional radius."""
    return f"radius_{factor:g}"


def reduced(first: float, iteration: int, alpha: float, samples: int = 1) -> float:
    """Radius of the pass with number ``iteration``, from 0; ``first``: that of pass 0; ``samples``: camera paths per
    pixel and pass. It is the radius that passes of one camera path per pixel [Georgiev 2012, eq. 10] have after the
    same number of camera paths."""
    return float(first * (iteration * samples + 1) ** ((alpha - 1.0) / 2.0))


@dataclass(frozen=True)
class FirstRadius:
    """The radius of the first pass."""

    largest: float  #: render space
    places: Places | None = None  #: how the radius varies; None: the same everywhere
    #: Points that the pixels see, mask of those that are there; None if the radius is given, and not to be bounded.
    seen: tuple[mi.Point3f, mi.Bool] | None = None

    def share(self, position: mi.Point3f) -> mi.Float:
        """Area of the disc at a position, relative to that of the largest radius."""
        return mi.Float(1.0) if self.places is None else self.places.share(position)


@dataclass(frozen=True)
class Balls:
    """Merging in media: light vertices within a ball. Its volume is proportional to the area of the largest disc on
    surfaces, so that both are reduced alike: the area by r^2, the volume by r^3 [KnausZwicker 2011]."""

    thickness: float = 0.0  #: volume over area, render space; 0: no merging in media

    def radius(self, disc: float) -> float:
        """Radius of the ball of a pass; ``disc``: the largest radius on surfaces."""
        return float(0.75 * self.thickness * disc**2) ** (1.0 / 3.0)


def first_balls(method: ImageMethod, discs: FirstRadius, radius: float, unit: str, photons: Pilot | None) -> Balls:
    """The balls of the first pass of a prepared method. ``discs``: the discs of that pass; ``radius``, ``unit``: the
    settings; ``photons``: those of a pilot, by which an automatic radius is chosen: so that a ball around a point at
    which camera paths first collide holds :data:`_IN_BALL` of the light vertices that are traced for one camera path of
    each pixel, but is not wide against the free paths."""
    noted, scale = method.notes["merge_radius"], method.problem.space.scale
    disc = noted["scene_units"] * scale
    units = {"scene": half_diagonal(method), "absolute": scale, "pixel": disc / noted["pixels"]}
    ball = radius * units[unit] if radius else _BALL * disc
    if not radius and photons is not None and (distance := photons.distance(method)):
        ball = min(max(distance, _BALLS[0] * disc), _BALLS[1] * disc)
    if not radius and method.visibility.media is not None:
        ball = min(ball, _IN_FREE_PATH / method.visibility.media.densest)
    method.notes["volume_radius"] = {"scene_units": float(f"{ball / scale:.4g}")}
    return Balls(4.0 / 3.0 * ball**3 / discs.largest**2)


@dataclass(frozen=True)
class Pilot:
    """Light vertices of ``paths`` light paths, for the radius in media; ``per_pixel``: light paths per camera path."""

    vertices: LightVertices
    paths: int
    per_pixel: float

    def distance(self, method: ImageMethod) -> float | None:
        """Radius of a ball as :func:`first_balls` describes it, in the median over the points; None if camera paths or
        light paths do not collide."""
        positions, _, held = self.vertices.positions(in_media=True)
        tree = KdTree(positions, held)
        lanes = dr.arange(mi.UInt32, min(method.camera.pixels, 1 << 12))
        source = IndependentSource(lanes, 0, "pilot collisions", 0)
        pixel = mi.UInt32(mi.Float(method.camera.pixels) * (mi.Float(lanes) + 0.5) / len(lanes))
        ray, _, _ = method.camera.primary(dr.minimum(pixel, method.camera.pixels - 1), source)
        point, reached = first_collisions(method.walker(Walker), ray, source)
        far = dr.opaque(mi.Float, (2.0 * half_diagonal(method)) ** 2)
        squared = tree.kth_distance_squared(point, dr.opaque(mi.UInt32, _NEIGHBOUR), far, reached)
        dr.eval(squared, reached)
        found = np.array(squared)[np.array(reached)]
        if tree.count < _NEIGHBOUR or len(found) < _NEIGHBOUR:
            return None
        share = _IN_BALL / _NEIGHBOUR * self.paths / (self.per_pixel * method.camera.pixels)
        # In steps, so that rounding on another device does not change the picture.
        distance = math.sqrt(float(np.median(found))) * share ** (1.0 / 3.0)
        return 2.0 ** (round(8.0 * math.log2(distance)) / 8.0)


def bounded(method: ImageMethod, first: FirstRadius, gather: Gather, share: float) -> FirstRadius:
    """An automatic radius, reduced where photons are dense: so that a disc holds :data:`_MOST_PHOTONS` of a pass in the
    mean over the pixels. More of them take more time than their light is worth, most of which connections find as well.

    ``gather``: light vertices of a pilot, in a grid for the radius ``first``; ``share``: its light paths over those of
    a pass."""
    if first.seen is None:
        return first
    point, there = first.seen
    limit = first.share(point) * dr.opaque(mi.Float, first.largest**2)
    depth = dr.opaque(mi.UInt32, _ANY_DEPTH)
    count = gather.around(point, depth, lambda _, found: found + 1, mi.UInt32(0), there, limit)
    dr.eval(count)
    photons = float(np.array(count).sum()) / max(1, int(np.array(there).sum())) / share
    if photons <= _MOST_PHOTONS:
        return first
    # In steps, so that the order of atomic additions in the pilot does not change the picture.
    factor = 2.0 ** (round(8.0 * math.log2(_MOST_PHOTONS / photons) / 2.0) / 8.0)
    _note(method, {name: value * factor for name, value in method.notes["merge_radius"].items()})
    return replace(first, largest=first.largest * factor)


def _note(method: ImageMethod, radius: Mapping[str, float]) -> None:
    """Note a radius for the metadata of pictures."""
    method.notes["merge_radius"] = {name: float(f"{value:.4g}") for name, value in radius.items()}


def first_radius(method: ImageMethod, radius: float, unit: str) -> FirstRadius:
    """The radius of a prepared method's first pass from its settings. The one at the median distance of what the pixels
    see is added to the method's ``notes``."""
    pixel, distances, seen = _sight(method)
    if radius > 0.0 and unit != "pixel":
        size = method.problem.space.scale if unit == "absolute" else half_diagonal(method)
        first, median = FirstRadius(radius * size), radius * size
    else:
        wanted = (radius or _PIXELS * (method.camera.pixels / _PICTURE) ** _GROWTH) * pixel
        bounds = None if radius else seen
        first, median = FirstRadius(wanted, seen=bounds), wanted
        if distances is not None:
            middle = float(np.median(distances))
            least, tenth = (float(value) for value in np.quantile(distances, (_NEAREST, 0.1)))
            most = min(_FAR[0] * tenth, _FAR[1] * middle, float(distances.max()))
            least = max(least, _LEAST * most)
            places = Places(mi.Point3f(method.camera.origin), mi.Float(least**2), mi.Float(most**2))
            dr.make_opaque(places.origin, places.least, places.most)
            first, median = FirstRadius(wanted * most / middle, places, bounds), wanted * min(most / middle, 1.0)
    _note(method, {"scene_units": median / method.problem.space.scale, "pixels": median / pixel})
    return first


def _sight(method: ImageMethod) -> tuple[float, np.ndarray | None, tuple[mi.Point3f, mi.Bool]]:
    """(width of a pixel on the surface that the median pixel sees, distances of these surfaces from the sensor, or None
    if the width does not depend on them, points on them and where they are valid), render space. The surfaces are the
    first that are not specular; the camera rays are the same for every seed."""
    camera = method.camera
    lanes = dr.arange(mi.UInt32, min(camera.pixels, 1 << 14))
    source = IndependentSource(lanes, 0, "pilot camera", 0)
    pixel = mi.UInt32(mi.Float(camera.pixels) * (mi.Float(lanes) + 0.5) / len(lanes))
    ray, _, aperture = camera.primary(dr.minimum(pixel, camera.pixels - 1), source)
    bsdfs = [one for one in materials(method.scene) if isinstance(one, mi.BSDF)]
    through = any(not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth) for bsdf in bsdfs)
    position, reached = first_smooth(method.visibility, ray, through)
    if not camera.can_splat:  # parallel rays
        dr.eval(position, reached)
        return float(np.array(camera.footprint(ray.o, aperture)).ravel()[0]), None, (position, reached)
    distance, density = dr.norm(position - camera.origin), camera.density(ray, aperture)[0]
    dr.eval(distance, density, position, reached)
    angle = 1.0 / math.sqrt(float(np.median(np.array(density))))
    seen = np.array(distance)[np.array(reached)]
    if not len(seen):
        return angle * half_diagonal(method), None, (position, reached)
    return angle * float(np.median(seen)), seen, (position, reached)


def half_diagonal(method: ImageMethod) -> float:
    """Half the diagonal of the bounding box of a prepared method's scene."""
    lower, upper = corners_of(method.scene)
    return 0.5 * float(np.linalg.norm(upper - lower))
