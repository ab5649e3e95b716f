"""Radii of merging and gathering, and their units."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import IndependentSource, OptionError
from etendue.scene import Problem

from .base import ImageMethod

#: Names of the units; see :func:`absolute_radius`.
UNITS = ("scene", "pixel", "absolute")
UNIT_DOC = (
    "unit of radius: half the diagonal of the scene's bounding box (scene), the median width of a pixel on the first "
    "surfaces that camera rays hit (pixel), or scene units (absolute)"
)
#: Most additional radii of a run; each needs registers and memory.
MORE_RADII = 4


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


def half_diagonal(method: ImageMethod) -> float:
    """Half the diagonal of the bounding box of a prepared method's scene."""
    lower, upper = corners(method.problem)
    return 0.5 * float(np.linalg.norm(upper - lower))


def absolute_radius(method: ImageMethod, radius: float, unit: str, seed: int) -> float:
    """``radius`` in units of a prepared method's render space (``Problem.space``)."""
    match unit:
        case "absolute":
            return float(radius * method.problem.space.scale)
        case "scene":
            return float(radius * half_diagonal(method))
    return float(radius * _pixel_footprint(method, seed))


def _pixel_footprint(method: ImageMethod, seed: int) -> float:
    """Median width of a pixel on the first surfaces that camera rays hit; 0.002 of the half diagonal without hits."""
    camera = method.camera
    lanes = dr.arange(mi.UInt32, min(camera.pixels, 1 << 14))
    source = IndependentSource(lanes, seed, "pilot camera", 0)
    pixel = mi.UInt32(mi.Float(camera.pixels) * (mi.Float(lanes) + 0.5) / len(lanes))
    ray, _, aperture = camera.primary(dr.minimum(pixel, camera.pixels - 1), source)
    si = method.scene.ray_intersect(ray)
    side = np.asarray(dr.select(si.is_valid(), camera.footprint(si.p, aperture), dr.inf))
    side = side[np.isfinite(side)]
    return float(np.median(side)) if len(side) else 0.002 * half_diagonal(method)


def corners(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of a scene's bounding box."""
    box = problem.scene.bbox()
    return np.asarray(box.min, float).ravel(), np.asarray(box.max, float).ravel()
