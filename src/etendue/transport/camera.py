"""The camera end of a path: primary rays, and connections of surface points to the sensor (splats)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import SampleSource
from etendue.film import PixelFilter
from etendue.scene import Packet, Problem, is_spectral

from . import dimensions as dim
from .packing import packed_sum, unpacked_sum

#: Most memory, in bytes, for the copies of the splat images, one copy per thread.
_EXPAND_BYTES = 64e6


@dataclass
class CameraConnection:
    """A surface point connected to the sensor, one lane each."""

    position: mi.Point2f  #: film point in pixels
    direction: mi.Vector3f  #: world, from the surface to the sensor
    target: mi.Point3f  #: end of the shadow ray, on the near plane
    distance: mi.Float  #: to the aperture point
    importance: mi.Float  #: importance of one pixel, over squared distance
    active: mi.Bool

    def area_pdf(self, cos: mi.Float) -> mi.Float:
        """Area density at the surface of a camera ray uniform in its pixel; ``cos``: absolute cosine at the surface."""
        return self.importance * cos


@dataclass
class SplatPlace:
    """Pixels that a splat is added to, one lane each."""

    taps: list[tuple[mi.UInt32, mi.Float, mi.Bool]]  #: (pixel or cell, weight, whether the pixel is on the film)
    weight: mi.Float  #: factor on the contribution, beside the filter weights
    on_film: mi.Bool  #: whether the splat's position is on the film


class Splats:
    """Images of splats on the device: sums over light paths, four floats per pixel or cell.

    ``shift``: two numbers in [0, 1) that shift the grid of cells (:class:`etendue.film.CellGrid`) and differ from pass
    to pass; ``None``: splats are added to pixels, as in the technique pyramid.
    """

    def __init__(self, camera: CameraSampler, images: int = 1, shift: tuple[float, float] | None = None) -> None:
        self._camera = camera
        grid = None if shift is None or camera.independent else camera.filter.cells(*shift)
        # The limit is that of 32-bit indices of floats.
        self._grid = grid if grid is not None and 4 * grid.count * images < 1 << 32 else None
        self._stride = camera.pixels if self._grid is None else self._grid.count
        self.array = dr.zeros(mi.Float, 4 * self._stride * images)
        # On a CPU, one copy of the images per thread is faster than atomic additions (a GPU ignores the mode).
        small = 16 * self._stride * images * dr.thread_count() <= _EXPAND_BYTES
        self._mode = dr.ReduceMode.Expand if small else dr.ReduceMode.Auto

    def place(self, connection: CameraConnection, source: SampleSource, vertex: mi.UInt32 | int) -> SplatPlace:
        """The pixels, or the cell, that a splat is added to."""
        sampled = self._camera.independent and not self._camera.filter.is_box
        return self.at(connection.position, source.next_2d(vertex, dim.SPLAT_FILTER) if sampled else (0.5, 0.5))

    def at(self, position: mi.Point2f, u: tuple[mi.Float | float, mi.Float | float]) -> SplatPlace:
        """The pixels, or the cell, of a film position in pixels. ``u``: two numbers that select the pixel if the
        reconstruction is independent."""
        camera, x, y = self._camera, position.x, position.y
        if camera.independent:
            pixel, weight, on_film = camera.filter.splat(x, y, *u)
            return SplatPlace([(pixel, mi.Float(1.0), on_film)], weight, on_film)
        on_film = camera.on_film(position)
        taps = camera.filter.taps(x, y) if self._grid is None else [(self._grid.cell(x, y), mi.Float(1.0), on_film)]
        return SplatPlace(taps, mi.Float(1.0), on_film)

    def add(self, place: SplatPlace, values: Sequence[mi.Spectrum], active: mi.Bool, first: int = 0) -> None:
        """Add a colour to each image from number ``first`` on, in each active lane."""
        for image, value in enumerate(values, first):
            self.add_to(image, place, value, active)

    def add_to(self, image: mi.UInt32 | int, place: SplatPlace, value: mi.Spectrum, active: mi.Bool) -> None:
        """Add a colour to the image with a given number, one lane each."""
        packet = packed_sum(self._camera.packet.recorded(value))
        for index, share, on_film in place.taps:
            index = index + image * self._stride
            dr.scatter_reduce(dr.ReduceOp.Add, self.array, packet * share, index, active & on_film, mode=self._mode)

    def sums(self, factor: float = 1.0) -> NDArray[np.float32]:
        """The images, times ``factor``, on the host, (images, height, width, 3) float32; with 4 channels, one for each
        wavelength, if the film records bands."""
        pixels = self._grid.pixels(self.array) if self._grid else dr.unravel(mi.Vector4f, self.array)
        colours = unpacked_sum(pixels, self._camera.packet) * dr.opaque(mi.Float, factor)
        return np.array(dr.ravel(colours)).reshape(-1, self._camera.height, self._camera.width, len(colours))


class CameraSampler:
    """Primary rays and splats of one sensor, with its film's reconstruction filter.

    ``independent``: the filter is importance sampled. A camera path then contributes to its own pixel and a splat to
    one pixel within the filter's radius, so that the noise of pixels is independent. Otherwise both contribute to all
    pixels within the radius: camera rays are uniform in their pixel, and ``filter.spread`` convolves their values.
    """

    def __init__(self, problem: Problem, independent: bool = False, packet: Packet | None = None) -> None:
        self.sensor = problem.sensor
        self.packet = packet or Packet()
        self.width, self.height = problem.size
        self.pixels = self.width * self.height
        self.filter = PixelFilter(self.sensor.film().rfilter(), self.width, self.height)
        self.independent = independent or self.filter.is_box or self.filter.has_gaps
        parameters = mi.traverse(self.sensor)
        self.near_clip = _scalar(parameters, "near_clip", 0.0)
        far_clip = _scalar(parameters, "far_clip", 1e4)
        #: A distance between the near and the far plane, at which the environment is connected to the sensor.
        self.far = 0.5 * (self.near_clip + far_clip)
        # Distance from the near plane to a point before the far plane, along any camera ray.
        self._reach = 0.5 * (far_clip - self.near_clip)
        self.origin = mi.Point3f(self.sensor.world_transform().translation())
        #: Whether surface points can be connected to the sensor; False for an orthographic one, with parallel rays.
        self.can_splat = _can_connect(self.sensor)

    def primary(self, pixel: mi.UInt32, source: SampleSource) -> tuple[mi.Ray3f, mi.Spectrum, mi.Point2f]:
        """A camera ray through ``pixel`` (index y * width + x): (ray, weight, aperture sample)."""
        y = pixel // self.width
        x = pixel - y * self.width
        u = source.next_2d(0, dim.FILM)
        if self.independent:
            film_x, film_y, weight = self.filter.camera(x, y, *u)
        else:
            film_x, film_y, weight = mi.Float(x) + u[0], mi.Float(y) + u[1], mi.Float(1.0)
        ray, sensor_weight, aperture = self.through(mi.Point2f(film_x, film_y), source)
        return ray, sensor_weight * weight, aperture

    def through(self, position: mi.Point2f, source: SampleSource) -> tuple[mi.Ray3f, mi.Spectrum, mi.Point2f]:
        """A camera ray through a film position in pixels: (ray, weight, aperture sample)."""
        aperture = mi.Point2f(0.5)
        if self.sensor.needs_aperture_sample():
            aperture = mi.Point2f(*source.next_2d(0, dim.APERTURE))
        on_film = mi.Point2f(position.x / self.width, position.y / self.height)
        ray, weight = self.sensor.sample_ray(0.0, 0.5, on_film, aperture)
        if is_spectral():
            weight /= self.sensor.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), 0.5)[1]
            ray.wavelengths = self.packet.wavelengths
        return ray, mi.Spectrum(weight), aperture

    def on_film(self, position: mi.Point2f) -> mi.Bool:
        """Whether a position in pixels is on the film."""
        x, y = position
        return (x >= 0.0) & (x < float(self.width)) & (y >= 0.0) & (y < float(self.height))

    def connect(self, si: mi.SurfaceInteraction3f, aperture: mi.Point2f, active: mi.Bool) -> CameraConnection:
        """Connect ``si`` to the point of the aperture sample ``aperture``. Inactive where the projection is off the
        film or the point outside the clipping planes."""
        ds, weight = self.sensor.sample_direction(si, aperture, active)
        importance = weight[0] * self.pixels
        # Camera rays start at the near plane, so a splat's shadow ray must end there.
        axial = dr.maximum(dr.dot(-ds.d, dr.normalize(ds.n)), 1e-6)
        target = ds.p - ds.d * (self.near_clip / axial)
        usable = active & (ds.pdf > 0.0) & (importance > 0.0)
        return CameraConnection(ds.uv, ds.d, target, ds.dist, importance, usable)

    def density(self, ray: mi.Ray3f, aperture: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """(solid-angle density of a camera ray uniform in its pixel, distance from the aperture point to the ray's
        origin) [Georgiev 2012b, eq. 31]; both 0 for a sensor that surface points cannot be connected to."""
        if not self.can_splat:
            return mi.Float(0.0), mi.Float(0.0)
        probe = dr.zeros(mi.Interaction3f)
        probe.p = ray.o + ray.d * self._reach
        ds, weight = self.sensor.sample_direction(probe, aperture)
        lead = dr.norm(ray.o - ds.p)
        return weight[0] * (self.pixels * dr.square(ds.dist)), lead

    def footprint(self, p: mi.Point3f, aperture: mi.Point2f) -> mi.Float:
        """Side of a pixel's footprint at points ``p`` that camera rays have hit, on a plane that faces the sensor, in
        scene units."""
        if not self.can_splat:
            corner, x, y = (
                self.sensor.sample_ray(0.0, 0.5, mi.Point2f(u, v), mi.Point2f(0.5))[0].o
                for u, v in ((0.5, 0.5), (0.5 + 1.0 / self.width, 0.5), (0.5, 0.5 + 1.0 / self.height))
            )
            return dr.sqrt(dr.norm(x - corner) * dr.norm(y - corner))
        point = dr.zeros(mi.Interaction3f)
        point.p = p
        return dr.rsqrt(self.sensor.sample_direction(point, aperture)[1][0] * self.pixels)

    def splat_aperture(self, source: SampleSource, vertex: mi.UInt32) -> mi.Point2f:
        """Aperture sample of a splat."""
        if self.sensor.needs_aperture_sample():
            return mi.Point2f(*source.next_2d(vertex, dim.SPLAT_APERTURE))
        return mi.Point2f(0.5)


def _can_connect(sensor: mi.Sensor) -> bool:
    """Whether a sensor implements ``sample_direction``."""
    try:
        sensor.sample_direction(dr.zeros(mi.Interaction3f), mi.Point2f(0.5))
    except (RuntimeError, NotImplementedError):
        return False
    return True


def _scalar(parameters: mi.SceneParameters, name: str, default: float) -> float:
    return float(np.asarray(parameters[name]).ravel()[0]) if name in parameters else default
