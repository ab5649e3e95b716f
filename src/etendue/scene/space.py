"""Render space: the coordinates that a scene is rendered in, which are its own unless rays would start too far off.

Mitsuba starts a ray ``mi.math.RayEpsilon (1 + m)`` off a surface, 8.9e-5 (1 + m), m being the largest coordinate there
(``SurfaceInteraction.offset_p``): 9 mm at 100 m from the origin, and 0.09 mm on a jewel of 2 cm in metres. In a Cornell
box an offset of the share x of half its diagonal changes what pixels have by about x, and the light in all by x / 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, logger

#: The largest offset that is left alone, and the least size that a scene is scaled to: both of half its diagonal.
_LARGEST_OFFSET, _LEAST_SIZE = 2e-3, 8.0
#: The largest step between neighbouring numbers of single precision that is left unsaid, of half the diagonal.
_LARGEST_STEP = 1e-4
_STEP = 2.0**-24

Point = tuple[float, float, float]


@dataclass(frozen=True)
class RenderSpace:
    """Coordinates ``scale (x - centre)`` of points x of the scene as it was given."""

    centre: Point = (0.0, 0.0, 0.0)
    scale: float = 1.0

    @classmethod
    def of(cls, scene: Any, sensor: Any) -> RenderSpace:
        """The space for a loaded scene: its own, unless the offset of rays is above 0.2 % of half its diagonal.

        Then the centre is the place of ``sensor``, or the point of the bounding box nearest to it: offsets grow with
        the distance from the centre, as what a pixel sees does. The scale is a power of two, and 1 for all but small
        scenes: to make one smaller would only make offsets larger beside what is near the centre.
        """
        if offset_share(scene) <= _LARGEST_OFFSET:
            return cls()
        lower, upper = _corners(scene)
        eye = np.asarray(sensor.world_transform().translation(), dtype=float).ravel()[:3]
        x, y, z = (float(v) for v in np.clip(eye, lower, upper))
        return cls((x, y, z), 2.0 ** max(0, math.ceil(math.log2(_LEAST_SIZE / half_diagonal(scene)))))

    @property
    def is_own(self) -> bool:
        """Whether the coordinates are those of the scene as it was given."""
        return self == RenderSpace()

    def from_scene(self, points: ArrayLike) -> Array:
        """Points (..., 3) of the scene as it was given, in render space."""
        return self.scale * (np.asarray(points, dtype=np.float64) - self.centre)

    def to_scene(self, points: ArrayLike) -> Array:
        """Points (..., 3) of render space, in the scene as it was given."""
        result: Array = np.asarray(points, dtype=np.float64) / self.scale + self.centre
        return result


def offset_share(scene: Any) -> float:
    """The largest distance that rays start off surfaces in a loaded scene, over half the diagonal of its bounding box;
    0 if that is empty or not finite."""
    import mitsuba as mi

    lower, upper = _corners(scene)
    size = half_diagonal(scene)
    if not 0 < size < math.inf:
        return 0.0
    return float(mi.math.RayEpsilon) * (1 + max(np.abs(lower).max(), np.abs(upper).max())) / size


def half_diagonal(scene: Any) -> float:
    """Half the diagonal of the bounding box of a loaded scene; 0 if that is empty."""
    lower, upper = _corners(scene)
    return float(np.linalg.norm(upper - lower)) / 2 if (upper >= lower).all() else 0.0


def warn_of_offsets(scene: Any, name: str, why: str = "a loaded scene is not moved") -> None:
    """Warn, once for each text, if rays in ``scene`` start so far off surfaces that its light changes."""
    share = offset_share(scene)
    if share > _LARGEST_OFFSET:
        _warn_once(
            f"{name}: rays start up to {share:.2g} of its size off its surfaces, which changes its light, and {why}; "
            "put it near the origin at a size of 1 to 100, or give it as a file or as a dictionary of plugins"
        )


def warn_of_steps(name: str, largest: float, size: float, remedy: str) -> None:
    """Warn if single precision holds coordinates as large as ``largest`` only to steps that matter in a scene of half
    the diagonal ``size``."""
    if _STEP * largest > _LARGEST_STEP * size:
        _warn_once(
            f"{name}: single precision holds coordinates of {largest:.2g} to {2 * _STEP * largest:.2g} only, "
            f"{2 * _STEP * largest / size:.2g} of the scene's size; {remedy}"
        )


@lru_cache(maxsize=256)
def _warn_once(text: str) -> None:
    logger.warning(text)


def _corners(scene: Any) -> tuple[Array, Array]:
    box = scene.bbox()
    return np.asarray(box.min, dtype=float).ravel(), np.asarray(box.max, dtype=float).ravel()
