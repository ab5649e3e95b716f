"""Render space: the coordinates in which a scene is rendered, its own unless the ray offset would be too large.

Mitsuba starts a ray ``mi.math.RayEpsilon (1 + m)`` off a surface, 8.9e-5 (1 + m), where m is the largest coordinate of
the point (``SurfaceInteraction.offset_p``): 9 mm at 100 m from the origin, and 0.09 mm on a jewel of 2 cm in metres. In
a Cornell box an offset of x times half its diagonal changes pixels by up to 2 x, and the mean by x / 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, logger

from .bounds import corners_of
from .graph import plugin_name

if TYPE_CHECKING:
    import mitsuba as mi

#: The largest accepted offset, relative to half the scene's diagonal or to the distance of visible surfaces; and the
#: smallest half diagonal after scaling, the smallest distance, and the largest size of the scene after that scaling.
_LARGEST_OFFSET, _LEAST_SIZE, _LEAST_DISTANCE, _LARGEST_SIZE = 2e-3, 8.0, 1.0, 1e5
#: Visible distances are measured only in scenes that extend further than the first number, or whose half diagonal is
#: below the second: in other scenes offsets matter only for tiny details. Third: rays per side of the film.
_FARTHEST, _SMALLEST, _RAYS = 30.0, 0.3, 16
#: The largest single-precision step without a warning, relative to half the diagonal.
_LARGEST_STEP = 1e-4
_STEP = 2.0**-24

#: Sensors that are supported: they see points in space, and can be moved.
SENSORS = ("perspective", "thinlens", "orthographic", "spherical")
#: Mitsuba's sensors that measure: along a ray, on a shape, and what leaves the scene in a direction.
METERS = ("radiancemeter", "irradiancemeter", "distant")

Point = tuple[float, float, float]


@dataclass(frozen=True)
class RenderSpace:
    """Coordinates ``scale (x - centre)`` of points x in the scene's own coordinates."""

    centre: Point = (0.0, 0.0, 0.0)
    scale: float = 1.0

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor) -> RenderSpace:
        """The space for a loaded scene: its own, unless the ray offset exceeds 0.2 % of half its diagonal, or of the
        median distance of the surfaces that ``sensor`` sees (a room in a large building, for example).

        Then the centre is the position of ``sensor``, or the point of the bounding box nearest to it: offsets grow with
        the distance from the centre, as pixel footprints do. The scale is a power of two, and 1 except for small
        scenes: shrinking a scene would only enlarge offsets relative to objects near the centre.
        """
        share, distance = _share(scene, sensor)
        if share <= _LARGEST_OFFSET:
            return cls()
        (lower, upper), size = corners_of(scene), half_diagonal(scene)
        eye = np.asarray(sensor.world_transform().translation(), dtype=float).ravel()[:3]
        x, y, z = (float(v) for v in np.clip(eye, lower, upper))
        scale = max(_LEAST_SIZE / size, min(_LEAST_DISTANCE / distance, _LARGEST_SIZE / size))
        # Rounded to a power of two, so that the rays of another device give the same scale.
        return cls((x, y, z), 2.0 ** max(0, round(math.log2(scale))))

    @property
    def is_own(self) -> bool:
        """Whether the coordinates are the scene's own."""
        return self == RenderSpace()

    def from_scene(self, points: ArrayLike) -> Array:
        """Points (..., 3) in the scene's own coordinates, converted to render space."""
        return self.scale * (np.asarray(points, dtype=np.float64) - self.centre)

    def to_scene(self, points: ArrayLike) -> Array:
        """Points (..., 3) in render space, converted to the scene's own coordinates."""
        result: Array = np.asarray(points, dtype=np.float64) / self.scale + self.centre
        return result


def largest_offset(scene: mi.Scene) -> float:
    """The largest ray offset in a loaded scene."""
    import mitsuba as mi

    return float(mi.math.RayEpsilon * (1 + np.abs(corners_of(scene)).max()))


def half_diagonal(scene: mi.Scene) -> float:
    """Half the diagonal of the bounding box of a loaded scene; 0 if the box is empty."""
    lower, upper = corners_of(scene)
    return float(np.linalg.norm(upper - lower)) / 2 if (upper >= lower).all() else 0.0


def warn_of_offsets(scene: mi.Scene, sensor: mi.Sensor, name: str, why: str = "a loaded scene is not moved") -> None:
    """Warn, once for each text, if the ray offset in ``scene`` is large enough to change its light."""
    if _share(scene, sensor)[0] > _LARGEST_OFFSET:
        warn_once(
            f"{name}: rays start up to {largest_offset(scene):.2g} off surfaces, which changes the light of a scene of "
            f"this size and position, and {why}; move it near the origin and scale it to a size of 1 to 100, or load "
            "it from a file or a dictionary of plugins"
        )


def warn_of_steps(name: str, largest: float, size: float, remedy: str) -> None:
    """Warn if the single-precision step at coordinates up to ``largest`` is too large for a scene with half the
    diagonal ``size``."""
    if _STEP * largest > _LARGEST_STEP * size:
        warn_once(
            f"{name}: single precision rounds coordinates of {largest:.2g} to multiples of {2 * _STEP * largest:.2g}, "
            f"{2 * _STEP * largest / size:.2g} of the scene's size; {remedy}"
        )


@lru_cache(maxsize=256)
def warn_once(text: str) -> None:
    """Log a warning, once for each text."""
    logger.warning(text)


def _share(scene: mi.Scene, sensor: mi.Sensor) -> tuple[float, float]:
    """(ray offset relative to half the diagonal or to the distance of the surfaces that ``sensor`` sees, whichever is
    larger; this distance, if it was measured). The relative offset is 0 if the bounding box is empty or not finite."""
    (lower, upper), size = corners_of(scene), half_diagonal(scene)
    if not 0 < size < math.inf:
        return 0.0, _LEAST_DISTANCE
    share, seen, distance = largest_offset(scene) / size, 0.0, _LEAST_DISTANCE
    if size < _SMALLEST or max(np.abs(lower).max(), np.abs(upper).max()) > _FARTHEST:
        seen, distance = _seen(scene, sensor)
    return max(share, seen), distance


def _seen(scene: mi.Scene, sensor: mi.Sensor) -> tuple[float, float]:
    """Medians of ray offset over distance and of the distance, over the surfaces that a sensor sees; 0 and the smallest
    distance if it sees none."""
    import drjit as dr
    import mitsuba as mi

    if plugin_name(sensor) not in SENSORS:
        return 0.0, _LEAST_DISTANCE
    place = (np.arange(_RAYS, dtype=np.float32) + 0.5) / _RAYS
    u, v = (a.ravel() for a in np.meshgrid(place, place))
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(u, v), mi.Point2f(0.5))
    t = scene.ray_intersect_preliminary(ray).t
    dr.eval(t, ray.o, ray.d)  # in one kernel
    distance = np.array(t, dtype=float)
    hit = np.isfinite(distance) & (distance > 0)
    if not hit.any():
        return 0.0, _LEAST_DISTANCE
    distance = distance[hit]
    origin, along = (np.stack([np.broadcast_to(x, hit.shape)[hit] for x in part]) for part in (ray.o, ray.d))
    point = origin + distance * along
    offset = float(mi.math.RayEpsilon) * (1 + np.abs(point).max(axis=0))
    return float(np.median(offset / distance)), float(np.median(distance))
