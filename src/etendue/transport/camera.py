"""The camera end of a path: primary rays, and joining a surface point to the sensor (the splat)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import SampleSource
from etendue.film import PixelFilter
from etendue.scene import Problem

from . import dimensions as dim

#: Most memory for a copy of the splatted image a thread.
_EXPAND_BYTES = 64e6


@dataclass
class CameraConnection:
    """A surface point joined to the sensor, one lane each."""

    position: Any  #: film point in pixels
    direction: Any  #: world, from the surface to the sensor
    target: Any  #: end of the shadow ray: the near plane on the way to the aperture point
    distance: Any  #: to the aperture point
    importance: Any  #: measurement contribution of one pixel per unit radiance, over squared distance
    active: Any

    def area_pdf(self, cos: Any) -> Any:
        """Area density, at the surface, of a camera ray uniform in its pixel; ``cos``: the absolute cosine there."""
        return self.importance * cos


@dataclass
class SplatPlace:
    """Where a splat goes, one lane each."""

    taps: list[tuple[Any, Any, Any]]  #: (pixel, its share, whether it is on the film)
    weight: Any  #: factor beside the shares
    on_film: Any


class Splats:
    """Images that light paths add to, on the device: sums over paths, a packet of four floats a pixel."""

    def __init__(self, pixels: int, images: int = 1) -> None:
        self._pixels = pixels
        self.array = dr.zeros(mi.Float, 4 * pixels * images)
        # On a CPU a copy a thread is faster than atomic additions, as long as there are few threads (ignored on a GPU).
        small = 16 * pixels * images * dr.thread_count() <= _EXPAND_BYTES
        self._mode = dr.ReduceMode.Expand if small else dr.ReduceMode.Auto

    def add(self, place: SplatPlace, values: Sequence[Any], active: Any) -> None:
        """Add a colour to each image, in each active lane."""
        for image, value in enumerate(values):
            packet = mi.Vector4f(value.x, value.y, value.z, 0.0)
            for pixel, share, on_film in place.taps:
                index = pixel + image * self._pixels
                dr.scatter_reduce(dr.ReduceOp.Add, self.array, packet * share, index, active & on_film, mode=self._mode)

    def sums(self, height: int, width: int) -> Any:
        """The images on the host, (images, height, width, 3) float32."""
        return np.asarray(self.array).reshape(-1, height, width, 4)[..., :3]


class CameraSampler:
    """Primary rays and splats of one sensor, with its film's reconstruction filter.

    ``independent``: a camera path counts for its own pixel, a splat for one of the pixels in reach, so that pixels
    share no noise. Otherwise both count for all pixels in reach; camera rays are uniform in their pixels then, and
    ``filter.spread`` makes pixels of what they bring.
    """

    def __init__(self, problem: Problem, independent: bool = False) -> None:
        self.sensor = problem.sensor
        self.width, self.height = problem.size
        self.pixels = self.width * self.height
        self.filter = PixelFilter(self.sensor.film().rfilter(), self.width, self.height)
        self.independent = independent or self.filter.is_box or self.filter.has_gaps
        parameters = mi.traverse(self.sensor)
        self.near_clip = _scalar(parameters, "near_clip", 0.0)
        far_clip = _scalar(parameters, "far_clip", 1e4)
        #: A distance within the sensor's range, where the environment is joined to it.
        self.far = 0.5 * (self.near_clip + far_clip)
        # From the near plane along any ray of the film, to a point before the far plane.
        self._reach = 0.5 * (far_clip - self.near_clip)
        self.origin = mi.Point3f(self.sensor.world_transform().translation())
        #: Whether surface points can be joined to the sensor; not to an orthographic one, whose rays are parallel.
        self.can_splat = _joins(self.sensor)

    def primary(self, pixel: Any, source: SampleSource) -> tuple[Any, Any, Any]:
        """A camera ray through ``pixel`` (index y * width + x): (ray, weight, aperture sample)."""
        y = pixel // self.width
        x = pixel - y * self.width
        u = source.next_2d(0, dim.FILM)
        if self.independent:
            film_x, film_y, weight = self.filter.camera(x, y, *u)
        else:
            film_x, film_y, weight = mi.Float(x) + u[0], mi.Float(y) + u[1], mi.Float(1.0)
        position = mi.Point2f(film_x / self.width, film_y / self.height)
        aperture = mi.Point2f(0.5)
        if self.sensor.needs_aperture_sample():
            aperture = mi.Point2f(*source.next_2d(0, dim.APERTURE))
        ray, sensor_weight = self.sensor.sample_ray(0.0, 0.5, position, aperture)
        return ray, mi.Color3f(sensor_weight) * weight, aperture

    def connect(self, si: Any, aperture: Any, active: Any) -> CameraConnection:
        """Join ``si`` to the aperture point ``aperture``. Inactive where the point is off the film or out of range."""
        ds, weight = self.sensor.sample_direction(si, aperture, active)
        importance = weight[0] * self.pixels
        # Camera rays start at the near plane, so a splat's shadow ray must end there.
        axial = dr.maximum(dr.dot(-ds.d, dr.normalize(ds.n)), 1e-6)
        target = ds.p - ds.d * (self.near_clip / axial)
        usable = active & (ds.pdf > 0.0) & (importance > 0.0)
        return CameraConnection(ds.uv, ds.d, target, ds.dist, importance, usable)

    def density(self, ray: Any, aperture: Any) -> tuple[Any, Any]:
        """Solid-angle density of a camera ray uniform in its pixel, 0 where the sensor cannot be joined; and how far
        from the aperture point the ray starts. [Georgiev 2012b, eq. 31]"""
        if not self.can_splat:
            return mi.Float(0.0), mi.Float(0.0)
        probe = dr.zeros(mi.Interaction3f)
        probe.p = ray.o + ray.d * self._reach
        ds, weight = self.sensor.sample_direction(probe, aperture)
        lead = dr.norm(ray.o - ds.p)
        return weight[0] * (self.pixels * dr.square(ds.dist)), lead

    def footprint(self, p: Any, aperture: Any) -> Any:
        """Side of a pixel, facing the sensor, at the points ``p`` that camera rays have reached; scene units."""
        if not self.can_splat:
            corner, x, y = (
                self.sensor.sample_ray(0.0, 0.5, mi.Point2f(u, v), mi.Point2f(0.5))[0].o
                for u, v in ((0.5, 0.5), (0.5 + 1.0 / self.width, 0.5), (0.5, 0.5 + 1.0 / self.height))
            )
            return dr.sqrt(dr.norm(x - corner) * dr.norm(y - corner))
        point = dr.zeros(mi.Interaction3f)
        point.p = p
        return dr.rsqrt(self.sensor.sample_direction(point, aperture)[1][0] * self.pixels)

    def splat_aperture(self, source: SampleSource, vertex: Any) -> Any:
        """Aperture sample of a splat."""
        if self.sensor.needs_aperture_sample():
            return mi.Point2f(*source.next_2d(vertex, dim.SPLAT_APERTURE))
        return mi.Point2f(0.5)

    def splat_place(self, connection: CameraConnection, source: SampleSource, vertex: Any) -> SplatPlace:
        """Where a splat goes."""
        x, y = connection.position.x, connection.position.y
        if self.independent:
            u = (0.5, 0.5) if self.filter.is_box else source.next_2d(vertex, dim.SPLAT_FILTER)
            pixel, weight, on_film = self.filter.splat(x, y, *u)
            return SplatPlace([(pixel, mi.Float(1.0), on_film)], weight, on_film)
        on_film = (x >= 0.0) & (x < float(self.width)) & (y >= 0.0) & (y < float(self.height))
        return SplatPlace(self.filter.taps(x, y), mi.Float(1.0), on_film)


def _joins(sensor: Any) -> bool:
    try:
        sensor.sample_direction(dr.zeros(mi.Interaction3f), mi.Point2f(0.5))
    except (RuntimeError, NotImplementedError):
        return False
    return True


def _scalar(parameters: Any, name: str, default: float) -> float:
    return float(np.asarray(parameters[name]).ravel()[0]) if name in parameters else default
